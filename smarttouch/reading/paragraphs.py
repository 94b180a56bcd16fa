"""Paragraphs of a page, joined from its lines as Braille transcribers do."""

import re
from collections.abc import Sequence

import numpy as np

from smarttouch.documents.text_lines import TextLine

_GAP = 1.35  # lines farther apart than this part of the usual distance begin a paragraph
_LARGER = 1.2
"""Ratio of x-heights from which lines are of different prints, as a heading and its text."""
_INDENT, _MOST_INDENT = 0.8, 8.0
"""Indent of a paragraph's first line, in x-heights; beside a picture it is more."""
_LEADERS = re.compile(r"(?:\s?[.·…•_]){4,}\s*")
"""Dots that lead to a page's number in a table of contents."""
_NUMBER = re.compile(r"[\W_]*(?:\d{1,4}|[ivxlc]{1,7})[\W_]*", re.IGNORECASE)
"""A line that is the number of a page."""
_NUMBERED = re.compile(r"(?:\d{1,4}|[ivxlc]{2,7})\s.+|.+\s(?:\d{1,4}|[ivxlc]{2,7})", re.IGNORECASE)
"""A line that begins or ends with one."""
_HEAD_GAP = 1.2  # distance of a running head from the text, of the usual one, at least
_HEAD_WORDS = 9


def paragraphs(
    lines: Sequence[TextLine], texts: Sequence[str], keep_headers: bool = False
) -> list[str]:
    """Return the paragraphs and headings of a page from its lines and their texts.

    A paragraph begins after a gap, with an indented or centered line, and with print of another
    size; a column continues in the next. Words that lines divide are joined; a hyphen stays where
    the page has the word with it.
    """
    step_mm = _usual_step_mm(lines)
    kept = list(range(len(texts)))
    if not keep_headers:
        kept = [k for k in kept if not _is_header(k, lines, texts, step_mm)]
    words = {word.lower() for text in texts for word in re.findall(r"\w+-\w+", text)}
    found: list[str] = []
    before: int | None = None
    right_mm = -np.inf
    for k in kept:
        text = _LEADERS.sub(" ", texts[k]).strip()
        if not text:
            continue
        if before is not None:
            right_mm = max(right_mm, lines[before].right_mm)
        if before is None or _begins(lines[before], lines[k], step_mm, right_mm):
            found.append(text)
        else:
            found[-1] = _joined(found[-1], text, words)
        if before is not None and _middle_mm(lines[k]) < _middle_mm(lines[before]):
            # The next column has its own right edge.
            right_mm = -np.inf
        before = k
    return found


def _middle_mm(line: TextLine) -> float:
    return (line.top_mm + line.bottom_mm) / 2


def _usual_step_mm(lines: Sequence[TextLine]) -> float:
    """Return the usual distance of lines; infinite for fewer than two."""
    steps = np.diff([_middle_mm(line) for line in lines])
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else np.inf


def _begins(before: TextLine, line: TextLine, step_mm: float, right_mm: float) -> bool:
    """Return whether a line begins a paragraph; ``right_mm`` is how far lines above it reach."""
    sizes = sorted((before.x_height_mm, line.x_height_mm))
    step = _middle_mm(line) - _middle_mm(before)
    if sizes[1] > _LARGER * sizes[0] or step >= _GAP * step_mm:
        return True
    if step <= 0:
        # The paragraph continues in the next column.
        return False
    indent = (line.left_mm - before.left_mm) / line.x_height_mm
    short, shorter = (
        (end_mm - line.right_mm) / line.x_height_mm for end_mm in (right_mm, before.right_mm)
    )
    centered = min(indent, short) > _INDENT or max(indent, shorter) < -_MOST_INDENT
    return _INDENT < indent < _MOST_INDENT or centered


def _is_header(index: int, lines: Sequence[TextLine], texts: Sequence[str], step_mm: float) -> bool:
    """Return whether a line is a running head, or the number of the page."""
    line, text = lines[index], texts[index].strip()
    middle = _middle_mm(line)
    others = np.array([_middle_mm(each) for k, each in enumerate(lines) if k != index])
    if not len(others):
        return False
    above, below = others[others < middle], others[others > middle]
    outermost = not (len(above) and len(below)) or (
        min(len(above), len(below)) == 1 and abs(np.sort(np.abs(others - middle))[0]) < step_mm / 2
    )
    if not outermost:
        return False
    if _NUMBER.fullmatch(text) and any(sign.isdigit() for sign in text):
        return True
    apart = float(np.abs(others - middle).min()) > _HEAD_GAP * step_mm
    return apart and len(text.split()) <= _HEAD_WORDS and bool(_NUMBERED.fullmatch(text))


def _joined(before: str, after: str, words: set[str]) -> str:
    """Return two lines as one: a hyphen goes where it divides a word, and stays in North-South."""
    if not before.endswith("-") or before.endswith(" -"):
        return f"{before} {after}"
    parts = re.search(r"\w+-$", before), re.match(r"\w+", after)
    whole = "".join(part[0] for part in parts if part is not None).lower()
    keeps = not after[:1].islower() or whole in words
    return (before if keeps else before[:-1]) + after
