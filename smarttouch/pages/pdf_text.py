"""Text that a PDF brings: its words by PDFium, put into lines, and compared with its print."""

import contextlib
import ctypes
import itertools
import math
import re
import statistics
import unicodedata
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.grey_image import LUMA
from smarttouch.pages.page_image import Page, TextLine
from smarttouch.pages.reading_order import MADE_SPACE, SPACE, Line, Word, reading_order, split
from smarttouch.pages.text_lines import find_lines

if TYPE_CHECKING:
    import pypdfium2

_ASCENT, _X_HEIGHT, _DESCENT = 0.74, 0.48, 0.22  # of most fonts; all in sizes of the letters
_LEVEL = 10.0  # angle in degrees from which text is aslant
_GAP, _TOUCHING = 0.7, 0.3  # gaps above which words end, and below which parts of a word touch
_SPACED, _WIDER = 0.8, 1.5  # gap of spaced letters, and ratio to it of the gap between their words
_SMALLER, _SHIFTED, _NEAR = 0.85, (0.1, 0.8), 0.55
"""Size of super- and subscripts, distance from the baseline, and from their word."""
_INITIAL = 1.8  # size of a letter over several lines
_ORDINAL = re.compile(r"(\d)\^(?=(?:st|nd|rd|th|er|re|e|o|a)\b)")
_BULLET = re.compile(r"^[\ue000-\uf8ff](?=\s|$)")  # codes of symbol fonts
_PLAIN = str.maketrans("\x02\xad\u2010\u2011\x00\ufffe", "----\ufffd\ufffd")
_FINE = 1000.0  # parts of a point in which PDFium gives places
_MOST_UNKNOWN = 0.05  # part of a text's characters that mean nothing
_VOWELS, _VOWEL_SHARE, _FEWEST = frozenset("aeiouyæœø"), (0.22, 0.62), 40
"""Part of Latin letters that are vowels in any language; fewest letters that show wrong codes."""
_COARSE_MM, _LETTERS_MM, _CONTRAST, _FEWEST_SPOTS = 0.25, (0.8, 12.0), 60, 4
"""Pixels, heights, contrast and number of the spots that may be print beside the text."""
_FAINT = 12  # levels of contrast below which print is not seen
_MOSTLY = 0.5  # print that the text lacks, relative to it, from which the picture is recognized


def turn_of_text(sheet: "pypdfium2.PdfPage") -> int:
    """Return by how many degrees, clockwise, a page must be turned for its text to be level."""
    counts = Counter(sign.turn_deg for sign in _signs(sheet, 0))
    return max(counts, key=lambda turn_deg: counts[turn_deg], default=0) or 0


def with_text(sheet: "pypdfium2.PdfPage", page: Page, point_mm: float, printed: int) -> Page:
    """Return a rendered page with its text; ``printed`` is the number of its characters before
    those in fields of a form."""
    signs = list(_signs(sheet, printed))
    turned = [sign for sign in signs if sign.turn_deg != 0]
    words = _words([sign for sign in signs if sign.turn_deg == 0])
    if not signs:
        return page
    seen = [word for word in words if _is_seen(page, word, point_mm)]
    letters = [unicodedata.bidirectional(letter) for word in words for letter in word.text]
    is_leftward = sum(letter in ("R", "AL") for letter in letters) > letters.count("L")
    found = reading_order(seen, sheet.get_height(), is_leftward)
    lines = [_text_line(line, point_mm) for line in found]
    texts = [_BULLET.sub("•", _ORDINAL.sub(r"\1", line.text)) for line in found]
    if 2 * len(turned) > len(signs) or not _makes_sense("".join(texts)):
        return _pictured(page, "most of its text is turned or makes no sense")
    others = _print_beside(page, words + turned, point_mm)
    if sum(map(_length, others)) > _MOSTLY * sum(map(_length, lines)):
        return _pictured(page, "much of its print is not in its text")
    notes = []
    if turned:
        text = "".join((" " if sign.before else "") + sign.text for sign in turned).strip()
        notes.append(f"turned text is left out: {text}")
    if len(seen) < len(words):
        notes.append(f"words that are not visible are left out: {len(words) - len(seen)}")
    if others:
        notes.append(f"print that is not in its text is left out (lines: {len(others)})")
    return replace(page, lines=tuple(lines), words=tuple(texts), notes=tuple(notes))


def _pictured(page: Page, reason: str) -> Page:
    return replace(page, notes=(f"{reason}, so its picture is recognized instead",))


def _signs(sheet: "pypdfium2.PdfPage", printed: int) -> Iterator[Word]:
    """Yield the characters on the visible page in the file's order."""
    import pypdfium2.raw as pdfium

    width, height = sheet.get_size()
    fine = round(_FINE * width), round(_FINE * height)
    across, down = ctypes.c_int(), ctypes.c_int()

    def view(x: float, y: float) -> tuple[float, float]:
        pdfium.FPDF_PageToDevice(sheet, 0, 0, *fine, 0, x, y, across, down)
        return across.value / _FINE, down.value / _FINE

    x, y, *sides = (ctypes.c_double() for _ in range(6))
    matrix, color = pdfium.FS_MATRIX(), [ctypes.c_uint() for _ in range(4)]
    before = SPACE
    with contextlib.closing(sheet.get_textpage()) as layer:
        for k in range(layer.count_chars()):
            text = chr(pdfium.FPDFText_GetUnicode(layer, k)).translate(_PLAIN)
            if text.isspace() or unicodedata.category(text) == "Cf":
                is_made = pdfium.FPDFText_IsGenerated(layer, k)
                mark = "\n" if text in "\r\n" else MADE_SPACE if is_made else SPACE
                before = max(before, mark, key=("", "\n", MADE_SPACE, SPACE).index)
                continue
            pdfium.FPDFText_GetCharOrigin(layer, k, x, y)
            pdfium.FPDFText_GetCharBox(layer, k, *sides)
            pdfium.FPDFText_GetMatrix(layer, k, matrix)
            left, right, bottom, top = (side.value for side in sides)
            corners = view(left, top), view(right, bottom)
            (left, right), (top, bottom) = map(sorted, zip(*corners, strict=True))
            size = abs(pdfium.FPDFText_GetFontSize(layer, k)) * math.hypot(matrix.c, matrix.d)
            if size > 0 and 0 < (left + right) / 2 < width and 0 < (top + bottom) / 2 < height:
                start = view(x.value, y.value)
                end = view(x.value + size * matrix.a, y.value + size * matrix.b)
                angle = math.degrees(math.atan2(start[1] - end[1], end[0] - start[0]))
                turn = round(angle / 90) % 4 * 90 if abs((angle + 45) % 90 - 45) < _LEVEL else None
                pdfium.FPDFText_GetFillColor(layer, k, *color)
                grey = float(np.dot(LUMA, [part.value for part in color[:3]]))
                place = k if k < printed else -1
                yield Word(text, left, right, start[1], size, place, before, turn, grey)
                before = ""


def _words(signs: list[Word]) -> list[Word]:
    """Return the words of level text, with ``^`` and ``_`` before super- and subscripts."""
    words: list[Word] = []
    for last, sign in itertools.pairwise([None, *signs]):
        assert sign is not None
        gap = sign.gap(last) / max(sign.size, last.size) if last else math.inf
        if (
            last is None
            or sign.before
            or gap > _GAP
            or abs(sign.y - last.y) > 0.05 * sign.size
            or abs(sign.size / last.size - 1) > 0.1
        ):
            is_touching = sign.before in ("", "\n") and gap < (_TOUCHING if sign.before else _GAP)
            before = "" if is_touching else SPACE if sign.before == SPACE else MADE_SPACE
            words.append(replace(sign, before=before))
        else:
            word = words[-1]
            word.text += sign.text
            word.left, word.right = min(word.left, sign.left), max(word.right, sign.right)
    _join_spaced(words)
    for word, after in itertools.pairwise(words):
        is_large = len(word.text) == 1 and word.size > _INITIAL * after.size
        is_lower = word.y - after.y > _NEAR * after.size
        if is_large and is_lower and abs(word.gap(after)) < after.size:
            after.text, word.text = word.text + after.text, ""
    words = [word for word in words if word.text]
    for number, word in enumerate(words):
        word.place = number if word.place >= 0 else number - len(words)
        for base in words[max(0, number - 1) : number] + words[number + 1 : number + 2]:
            raised = (base.y - word.y) / base.size
            is_near = abs(word.gap(base)) < _NEAR * base.size
            is_small = word.size < _SMALLER * base.size
            if is_small and is_near and _SHIFTED[0] < abs(raised) < _SHIFTED[1]:
                word.text = ("^" if raised > 0 else "_") + word.text
                word.y, word.size = base.y, base.size
                break
    return words


def _join_spaced(words: list[Word]) -> None:
    """Put letters of spaced print into the first of their word."""
    for run in split(
        words,
        lambda before, word: (
            word.before != MADE_SPACE
            or before.y != word.y
            or len(before.text + word.text) > 2
            or not (before.text + word.text).isalpha()
        ),
    ):
        gaps = [after.left - before.right for before, after in itertools.pairwise(run)]
        usual = statistics.median(gaps) if len(gaps) > 2 else math.inf
        if usual < _SPACED * run[0].size:
            for before, after in [*itertools.pairwise(run)][::-1]:
                if after.left - before.right < _WIDER * usual:
                    before.text, before.right = before.text + after.text, after.right
                    after.text = ""


def _text_line(line: Line, point_mm: float) -> TextLine:
    words = line.words
    size = statistics.median(word.size for word in words) * point_mm
    return TextLine(
        left_mm=min(word.left for word in words) * point_mm,
        right_mm=max(word.right for word in words) * point_mm,
        baseline=(statistics.median(word.y for word in words) * point_mm,),
        x_height_mm=_X_HEIGHT * size,
        ascent_mm=_ASCENT * size,
        descent_mm=_DESCENT * size,
        cell=int(line.is_cells),
    )


def _makes_sense(text: str) -> bool:
    """Return whether a text has neither unknown nor wrong codes."""
    unknown = sum(unicodedata.category(sign)[0] == "C" or sign == "\ufffd" for sign in text)
    # Accents become marks of their own.
    plain = unicodedata.normalize("NFD", text.lower())
    latin = [sign for sign in plain if sign.isalpha() and "LATIN" in unicodedata.name(sign, "")]
    share = sum(sign in _VOWELS for sign in latin) / max(1, len(latin))
    wrong = len(latin) >= _FEWEST and not _VOWEL_SHARE[0] < share < _VOWEL_SHARE[1]
    return unknown <= _MOST_UNKNOWN * len(text) and not wrong


def _length(line: TextLine) -> float:
    return line.right_mm - line.left_mm


def _is_seen(page: Page, word: Word, point_mm: float) -> bool:
    """Return whether a word has another color than its ground, or any contrast: scans have it."""
    box = _box(page, word, point_mm, _X_HEIGHT, 0.0, 0.0).astype(float)
    return not box.size or np.ptp(box) >= _FAINT or abs(box.mean() - word.grey) >= _FAINT


def _box(
    page: Page, word: Word, point_mm: float, above: float, below: float, beside: float
) -> NDArray[np.uint8]:
    """Return the pixels of a word, and around its baseline and ends, in sizes of its letters."""
    scale, size = point_mm / page.mm_per_pixel, word.size
    rows, columns = (
        slice(max(0, int(low * scale)), max(0, math.ceil(high * scale)))
        for low, high in (
            (word.y - above * size, word.y + below * size),
            (word.left - beside * size, word.right + beside * size),
        )
    )
    return page.grey[rows, columns]


def _print_beside(page: Page, words: list[Word], point_mm: float) -> list[TextLine]:
    """Return the lines of print on a page beside its words."""
    page = replace(page, grey=page.grey.copy())
    for word in words:
        box = _box(page, word, point_mm, 0.95, 0.4, 0.2)
        if box.size:
            box[:] = np.median(box)
    step = page.mm_per_pixel / _COARSE_MM
    coarse = cv2.resize(page.grey, None, fx=step, fy=step, interpolation=cv2.INTER_AREA)
    ink = np.abs(coarse - np.median(coarse)) > _CONTRAST
    heights = cv2.connectedComponentsWithStats(ink.astype(np.uint8))[2][1:, cv2.CC_STAT_HEIGHT]
    low, high = (height / _COARSE_MM for height in _LETTERS_MM)
    if np.count_nonzero((heights >= low) & (heights <= high)) < _FEWEST_SPOTS:
        return []
    # A scan may lie on its side.
    turned = Page(np.ascontiguousarray(np.rot90(page.grey)), page.mm_per_pixel)
    return find_lines(page, None) or find_lines(turned, None)
