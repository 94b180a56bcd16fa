"""Material to read: images, documents, texts and files of cells, page by page."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from smarttouch.base.errors import ReadingError
from smarttouch.pages.document import open_document, parse_pages
from smarttouch.pages.file_kinds import FileKind, file_kind, read_plain_text
from smarttouch.pages.page_image import Page
from smarttouch.pages.pandoc_text import read_pandoc_text
from smarttouch.pages.prepared_page import (
    PreparedPage,
    prepare_text,
)
from smarttouch.pages.text_lines import TextLine
from smarttouch.reading.recognition import (
    Note,
    RecognitionOptions,
    recognized_lines,
    upright_page,
)

TEXT = "text:"  # prefix of words that are not a file name
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
        cell = lines[k].cell
        if before is not None and cell > 1 and lines[before].cell == cell - 1:
            found[-1] += f"; {text}"
        elif (
            before is None
            or cell == 1
            or lines[before].cell
            or _begins(lines[before], lines[k], step_mm, right_mm)
        ):
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
    if before.cell or line.cell or line.initial_mm:
        return True
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


def document_pages(
    path: Path, options: RecognitionOptions, note: Note
) -> Iterator[tuple[int, Page]]:
    """Yield numbers and pages of a document, one in memory at a time.

    An assumed scale is reported only where it matters: every line is made as high as the array.
    """
    with open_document(
        path, dpi=options.dpi, page_width_mm=options.page_width_mm, password=options.password
    ) as document:
        wanted = (
            parse_pages(options.pages, len(document)) if options.pages else range(len(document))
        )
        for index in wanted:
            before = len(document.notes)
            page = document.page(index)
            if options.scale_matters:
                for words in document.notes[before:]:
                    note(words)
            yield index + 1, page


def report_empty_pages(found: dict[int, bool], note: Note) -> None:
    """Report pages by number on which no text was found; raise if it was found on none."""
    if not any(found.values()):
        raise ReadingError(
            "no line of text was found: is it a page of print, sharp, and large enough "
            "(letters of 6 pixels and more)?"
        )
    if empty := [str(number) for number, has_text in found.items() if not has_text]:
        note(f"no line of text on page {', '.join(empty)}")


def prepared_pages(
    pages: Iterator[tuple[int, Page]], options: RecognitionOptions, note: Note
) -> Iterator[PreparedPage]:
    """Yield the pages that carry text, see `upright_page`; raise if none does."""
    found: dict[int, bool] = {}
    for number, page in pages:
        prepared = upright_page(number, page, options, note)
        found[number] = bool(prepared.lines)
        if prepared.lines:
            yield prepared
    report_empty_pages(found, note)


def recognized_text(prepared: PreparedPage, options: RecognitionOptions, note: Note) -> str:
    """Return the text of a page, a line for each paragraph, see `paragraphs`."""
    texts = [text for _, text in recognized_lines(prepared, options, note)]
    return "\n".join(paragraphs(prepared.lines, texts, options.keep_headers))


_PRINTED_AT_ONCE = 20  # lines of a text on one printed page


@dataclass(frozen=True)
class ReadingMaterial:
    """Material that can be read: a file, or ``text:`` and words; warnings go to ``note``."""

    name: str
    options: RecognitionOptions = field(default_factory=RecognitionOptions)
    note: Note = lambda _words: None

    @property
    def title(self) -> str:
        """Title on the screen."""
        return "a text" if self.name.startswith(TEXT) else Path(self.name).name

    @cached_property
    def kind(self) -> FileKind:
        """Kind of what it holds."""
        return FileKind.TEXT if self.name.startswith(TEXT) else file_kind(Path(self.name))

    @property
    def holds_cells(self) -> bool:
        """True if it is a file of Braille cells."""
        return self.kind is FileKind.BRF

    @cached_property
    def words(self) -> str | None:
        """The text itself; None for images and cells."""
        if self.name.startswith(TEXT):
            return self.name[len(TEXT) :]
        if self.kind is FileKind.TEXT:
            return read_plain_text(Path(self.name))
        if self.kind is FileKind.STRUCTURED:
            return read_pandoc_text(Path(self.name), self.note)
        return None

    def numbers(self) -> list[int]:
        """Return the numbers of the pages of a document that are asked for."""
        with open_document(Path(self.name), password=self.options.password) as document:
            count = len(document)
        if not self.options.pages:
            return list(range(1, count + 1))
        return [index + 1 for index in parse_pages(self.options.pages, count)]

    def pages(self) -> Iterator[tuple[int, Page]]:
        """Yield numbers and pages of a document."""
        return document_pages(Path(self.name), self.options, self.note)

    def prepared(self) -> Iterator[PreparedPage]:
        """Yield pages with print on them: of a document, or of a text as it is printed."""
        words = self.words
        if words is None:
            yield from prepared_pages(self.pages(), self.options, self.note)
            return
        lines = words.splitlines()
        parts = [
            "\n".join(lines[start : start + _PRINTED_AT_ONCE])
            for start in range(0, len(lines), _PRINTED_AT_ONCE)
        ]
        for part in [part for part in parts if part.strip()] or [""]:
            yield prepare_text(part)
