"""Text that a PDF brings: its characters by PDFium, put into lines, and compared with its print."""

import contextlib
import ctypes
import itertools
import math
import re
import statistics
import unicodedata
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np

from smarttouch.pages.page_image import Page, TextLine
from smarttouch.pages.reading_order import (
    DOUBTFUL,
    FIGURE,
    Line,
    Segment,
    are_apart,
    reading_order,
    split,
)
from smarttouch.pages.text_lines import find_lines

if TYPE_CHECKING:
    import pypdfium2

_ASCENT, _X_HEIGHT, _DESCENT = 0.74, 0.48, 0.22  # of most fonts; all in sizes of the letters
_ABOVE, _BELOW = 0.95, 0.3  # what of the picture belongs to text, in sizes of the letters
_LEVEL = 10.0  # angle in degrees from which text is aslant
_TOUCHING, _FARTHEST = 0.3, 2.5  # gaps that are no space after a moved pen, nor by a file's space
_SPACED, _WIDER = 0.8, 1.5  # gap of spaced letters, and ratio to it of the gap between their words
_EVEN, _EACH = 0.25, 0.4  # difference of the spaces of justified prose, and width for each of them
_SPACES = _NONE, _MOVED, _MADE, _TYPED = ("", "\n", "\t", " ")
"""What precedes a character: nothing, a new line, a gap, or a space of the file."""
_SMALLER, _SHIFTED, _FAR, _NEAR = 0.95, (0.1, 0.8), 0.3, 0.55
"""Size of super- and subscripts, distance from the baseline, and from their word."""
_INITIAL = 1.8  # size of a letter over several lines
_ORDINAL = re.compile(r"(\d)\^(?=(?:st|nd|rd|th|er|re|e|o|a)\b)")
_BULLET = re.compile(r"^[\ue000-\uf8ff](?=\s|$)")  # codes of symbol fonts
_PLAIN = str.maketrans("\x02\xad\u2010\u2011\x00\ufffe", "----\ufffd\ufffd")
_FINE = 1000.0  # parts of a point in which PDFium gives places
_MOST_UNKNOWN = 0.05  # part of a text's characters that mean nothing
_COARSE_MM, _LETTERS_MM, _CONTRAST, _FEWEST_SPOTS = 0.25, (0.8, 12.0), 60, 4
"""Pixels, heights, contrast and number of the spots that may be print beside the text."""
_FAINT = 12  # levels of contrast below which print is not seen
_MOSTLY = 0.5  # print that the text lacks, relative to it, from which the picture is recognized


@dataclass(frozen=True)
class _Sign:
    """Character on the visible page, y down, in points."""

    text: str
    left: float
    right: float
    y: float  # of its baseline
    size: float  # of its font
    space: str  # one of _SPACES
    is_filled: bool  # into a form
    turn_deg: int | None  # by which the page must be turned for it; None if it is aslant

    def gap(self, other: "_Sign") -> float:
        """Return the distance of the nearer ends of two characters, in sizes of the larger."""
        distance = max(other.left - self.right, self.left - other.right)
        return distance / max(self.size, other.size)


def turn_of_text(sheet: "pypdfium2.PdfPage") -> int:
    """Return by how many degrees, clockwise, a page must be turned for its text to be level."""
    counts = Counter(sign.turn_deg for sign in _signs(sheet, 0))
    return max(counts, key=lambda turn_deg: counts[turn_deg], default=0) or 0


def with_text(sheet: "pypdfium2.PdfPage", page: Page, point_mm: float, printed: int) -> Page:
    """Return a rendered page with its text; ``printed`` is the number of its characters before
    those in fields of a form."""
    signs = list(_signs(sheet, printed))
    turned = [sign for sign in signs if sign.turn_deg != 0]
    segments = _segments([sign for sign in signs if sign.turn_deg == 0])
    if not signs:
        return page
    letters = [unicodedata.bidirectional(sign.text[0]) for sign in signs]
    is_leftward = sum(letter in ("R", "AL") for letter in letters) > letters.count("L")
    boxes = [_box(page, part, point_mm) for part in segments]
    prints = [page.grey[box] for box in boxes]
    seen = [
        segment for segment, print_ in zip(segments, prints, strict=True)
        if not print_.size or np.ptp(print_) >= _FAINT
    ]  # fmt: skip
    hidden = len(segments) - len(seen)
    boxes += [_box(page, sign, point_mm) for sign in turned]
    ordered = reading_order(seen, sheet.get_height(), is_leftward)
    lines = [_text_line(line, point_mm) for line in ordered]
    texts = [_BULLET.sub("•", _ORDINAL.sub(r"\1", line.text)) for line in ordered]
    others = _print_beside(page, boxes)
    is_poor = 2 * len(turned) > len(signs) or not _makes_sense("".join(texts))
    if is_poor or _length(others) > _MOSTLY * _length(lines):
        reason = "most of its text is turned or unknown, or much of its print is not text"
        return replace(page, notes=(f"{reason}, so its picture is recognized instead",))
    notes = [DOUBTFUL] if any(line.is_doubtful for line in ordered) else []
    if turned:
        text = "".join((" " if sign.space else "") + sign.text for sign in turned).strip()
        notes.append(f"turned text is left out: {text}")
    if hidden:
        notes.append(f"text that is not visible is left out (parts of lines: {hidden})")
    if others:
        notes.append(f"print that is not in its text is left out (lines: {len(others)})")
    return replace(page, lines=tuple(lines), words=tuple(texts), notes=tuple(notes))


def _signs(sheet: "pypdfium2.PdfPage", printed: int) -> Iterator[_Sign]:
    """Yield the characters on the visible page in the file's order."""
    import pypdfium2.raw as pdfium

    width, height = sheet.get_size()
    fine = round(_FINE * width), round(_FINE * height)
    across, down = ctypes.c_int(), ctypes.c_int()

    def view(x: float, y: float) -> tuple[float, float]:
        pdfium.FPDF_PageToDevice(sheet, 0, 0, *fine, 0, x, y, across, down)
        return across.value / _FINE, down.value / _FINE

    x, y, *sides = (ctypes.c_double() for _ in range(6))
    matrix = pdfium.FS_MATRIX()
    space = _TYPED
    with contextlib.closing(sheet.get_textpage()) as layer:
        for k in range(layer.count_chars()):
            text = chr(pdfium.FPDFText_GetUnicode(layer, k)).translate(_PLAIN)
            if text.isspace() or unicodedata.category(text) == "Cf":
                is_made = pdfium.FPDFText_IsGenerated(layer, k)
                mark = _MOVED if text in "\r\n" else _MADE if is_made else _TYPED
                space = max(space, mark, key=_SPACES.index)
                continue
            pdfium.FPDFText_GetCharOrigin(layer, k, x, y)
            pdfium.FPDFText_GetCharBox(layer, k, *sides)
            pdfium.FPDFText_GetMatrix(layer, k, matrix)
            left, right, bottom, top = (side.value for side in sides)
            corners = view(left, top), view(right, bottom)
            (left, right), (top, bottom) = map(sorted, zip(*corners, strict=True))
            size = abs(pdfium.FPDFText_GetFontSize(layer, k)) * math.hypot(matrix.c, matrix.d)
            if size > 0 and 0 < (left + right) / 2 < width and 0 < (top + bottom) / 2 < height:
                angle = math.degrees(math.atan2(matrix.b, matrix.a)) - sheet.get_rotation()
                turn = round(angle / 90) % 4 * 90 if abs((angle + 45) % 90 - 45) < _LEVEL else None
                baseline = view(x.value, y.value)[1]
                yield _Sign(text, left, right, baseline, size, space, k >= printed, turn)
                space = _NONE


def _segments(signs: list[_Sign]) -> list[Segment]:
    """Return level text as segments, with ``^`` and ``_`` before super- and subscripts."""
    segments: list[Segment] = []
    for line in split(
        signs, lambda last, sign: abs(sign.y - last.y) > _SHIFTED[1] * max(sign.size, last.size)
    ):
        tracking, widest = _spacing(line)
        for last, sign in itertools.pairwise([None, *line]):
            if sign and not (last and _is_joined(segments[-1], last, sign, tracking, widest)):
                position = -1 if sign.is_filled else len(segments)
                segments.append(
                    Segment(sign.text, sign.left, sign.right, sign.y, sign.size, position)
                )
    return segments


def _spacing(line: list[_Sign]) -> tuple[float, float]:
    """Return the gap of spaced letters, and the widest gap that is a space of justified prose, in
    their sizes; 0 if a line is neither."""
    gaps = [sign.gap(last) for last, sign in itertools.pairwise(line)]
    spaces = [gap for gap, sign in zip(gaps, line[1:], strict=True) if sign.space == _MADE]
    words = "".join(sign.space + sign.text for sign in line).split()
    is_even = len(spaces) > 1 and max(spaces) - min(spaces) < _EVEN
    if is_even and sum(len(word) > 1 and not FIGURE.fullmatch(word) for word in words) > 2:
        return 0.0, _EACH * (len(spaces) + 1)
    typical = statistics.median(gaps) if len(gaps) > 2 else math.inf
    is_spaced = typical < _SPACED and "".join(words).isalpha()
    return (typical, 2 * _WIDER * typical) if is_spaced else (0.0, 0.0)


def _is_joined(segment: Segment, last: _Sign, sign: _Sign, tracking: float, widest: float) -> bool:
    """Add a character to the segment of the one before it; return whether it belongs there."""
    gap = sign.gap(last)
    raised = (segment.y - sign.y) / max(segment.size, sign.size)
    is_space = sign.space == _TYPED or (
        gap > _WIDER * tracking and (sign.space == _MADE or (gap > _TOUCHING and sign.space))
    )
    text = " " * bool(is_space) + sign.text
    is_script = gap < _NEAR and _SHIFTED[0] < abs(raised) < _SHIFTED[1]
    is_initial = len(segment.text) == 1 and segment.size > _INITIAL * sign.size
    if is_initial and raised > 0 and gap < 1:
        segment.text += text
        segment.y, segment.size = sign.y, sign.size
    elif is_script and segment.size < _SMALLER * sign.size:
        segment.text = ("^" if raised < 0 else "_") + segment.text + text
        segment.y, segment.size = sign.y, sign.size
    elif is_script and (sign.size < _SMALLER * segment.size or abs(raised) > _FAR):
        mark = "^" if raised > 0 else "_"
        segment.text += text if last.y == sign.y else text.replace(sign.text, mark + sign.text)
    elif (
        gap > _FARTHEST if sign.space == _TYPED
        else gap > widest and are_apart(segment.text, sign.text, gap)
    ):  # fmt: skip
        return False
    else:
        segment.text += text
    segment.left, segment.right = min(segment.left, sign.left), max(segment.right, sign.right)
    return True


def _text_line(line: Line, point_mm: float) -> TextLine:
    words = line.segments
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
    """Return whether a text has few unknown codes."""
    unknown = sum(unicodedata.category(sign)[0] == "C" or sign == "\ufffd" for sign in text)
    return unknown <= _MOST_UNKNOWN * len(text)


def _length(lines: list[TextLine]) -> float:
    return sum(line.right_mm - line.left_mm for line in lines)


_Box = tuple[slice, slice]  # rows and columns of a page


def _box(page: Page, part: Segment | _Sign, point_mm: float) -> _Box:
    """Return the pixels of text and a little around it."""
    scale, size = point_mm / page.mm_per_pixel, part.size
    top, bottom = part.y - _ABOVE * size, part.y + _BELOW * size
    left, right = part.left - _BELOW * size, part.right + _BELOW * size
    rows, columns = (
        slice(max(0, int(low * scale)), max(0, math.ceil(high * scale)))
        for low, high in ((top, bottom), (left, right))
    )
    return rows, columns


def _print_beside(page: Page, boxes: list[_Box]) -> list[TextLine]:
    """Return the lines of print on a page outside boxes."""
    grey = page.grey.copy()
    for box in boxes:
        if grey[box].size:
            grey[box] = np.median(grey[box])
    step = page.mm_per_pixel / _COARSE_MM
    coarse = cv2.resize(grey, None, fx=step, fy=step, interpolation=cv2.INTER_AREA)
    ink = np.abs(coarse - np.median(coarse)) > _CONTRAST
    heights = cv2.connectedComponentsWithStats(ink.astype(np.uint8))[2][1:, cv2.CC_STAT_HEIGHT]
    low, high = (height / _COARSE_MM for height in _LETTERS_MM)
    if np.count_nonzero((heights >= low) & (heights <= high)) < _FEWEST_SPOTS:
        return []
    # A scan may lie on its side.
    turned = Page(np.ascontiguousarray(np.rot90(grey)), page.mm_per_pixel)
    return find_lines(replace(page, grey=grey), None) or find_lines(turned, None)
