"""Text layers of PDF pages: their words as lines in reading order, rows of tables whole."""

import ctypes
import itertools
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.pages.page_image import Page
from smarttouch.pages.reading_order import reading_order
from smarttouch.pages.text_lines import TextLine

if TYPE_CHECKING:
    import pypdfium2

_EM = 1.15  # height of a character's box, in sizes of its font
_ASCENT, _X_HEIGHT, _DESCENT = 0.74, 0.48, 0.22  # of most fonts, in their sizes
_SAME_LINE = 0.3  # distance of baselines of one line, in sizes
_SPACE, _APART = 0.17, 1.1  # least gap between words, and between columns, in sizes
_NARROW, _ALIGNED, _EXACT, _NEAR, _ALIKE = 0.5, 0.25, 0.1, 6, 2
"""Least gap, in sizes, that ends where those of rows around do: how near, how near the ends of
figures are, of how many rows, and how many of them."""
_COLUMNS = 2  # fewest columns of figures in rows without a wide gap
_CELL_WORDS, _TABLE_ROWS = 3.0, 2  # mean words of a table's cells at most, and rows at least
_FARTHER = 1.6  # distance of rows, in usual ones, at which those of a table end
_FEWEST = 40  # characters below which a page with a large picture is a scan with a stamp
_PICTURE = 0.4  # part of the page that a large picture covers
_MOST_UNKNOWN = 0.05  # part of a layer's characters that mean nothing
_VOWELS, _VOWEL_SHARE = frozenset("aeiouyæœø"), (0.22, 0.62)
"""Part of Latin letters that are vowels in any language; in a layer of wrong codes they are not."""


@dataclass(frozen=True, eq=False)
class LayeredPage(Page):
    """Page that brings its text: lines in reading order, and the words of each."""

    lines: tuple[TextLine, ...]
    words: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PicturedPage(Page):
    """Page whose text layer is not used, in words, so that its picture is recognized."""

    reason: str


@dataclass(frozen=True, eq=False)
class _Sign:
    text: str
    left: float
    right: float
    y: float  # of its baseline, down from the top; all in points
    size: float


def layered_page(
    sheet: "pypdfium2.PdfPage", page: Page, point_mm: float
) -> LayeredPage | PicturedPage | Page:
    """Return a rendered page with its text layer, or what is wrong with that; as it is without."""
    import pypdfium2

    rows = _rows(_signs(sheet))
    text = "".join(sign.text for row in rows for sign in row)
    reason = ""
    # The method of pypdfium2 has no answer for a damaged page, whose rotation is -1.
    if pypdfium2.raw.FPDFPage_GetRotation(sheet):
        reason = "its text is turned"
    elif not _makes_sense(text):
        reason = "its text makes no sense"
    elif len(text) < _FEWEST and _is_mostly_picture(sheet):
        reason = f"of its text there are {len(text)} characters beside a large picture"
    if not text:
        return page
    if reason:
        return PicturedPage(page.grey, page.mm_per_pixel, reason)
    pieces = [piece for row in _whole_tables(_cut(rows)) for piece in row]
    size = np.array([piece[0].size for piece in pieces])
    order = reading_order(
        np.array([min(sign.left for sign in piece) for piece in pieces]),
        np.array([max(sign.right for sign in piece) for piece in pieces]),
        np.array([piece[0].y for piece in pieces]),
        (_ASCENT + _DESCENT) * size,
    ).indices
    lines = tuple(_line(pieces[k], point_mm) for k in order)
    return LayeredPage(page.grey, page.mm_per_pixel, lines, tuple(_words(pieces[k]) for k in order))


def _signs(sheet: "pypdfium2.PdfPage") -> list[_Sign]:
    """Return the visible characters of a page."""
    import pypdfium2.raw as pdfium

    left, _, _, top = sheet.get_cropbox()
    found = []
    layer = sheet.get_textpage()
    try:
        box, x, y = pdfium.FS_RECTF(), ctypes.c_double(), ctypes.c_double()
        for k in range(layer.count_chars()):
            text = chr(pdfium.FPDFText_GetUnicode(layer, k))
            if text.isspace() or unicodedata.category(text) == "Cf":
                continue
            pdfium.FPDFText_GetLooseCharBox(layer, k, box)
            pdfium.FPDFText_GetCharOrigin(layer, k, x, y)
            size = (box.top - box.bottom) / _EM
            if size > 0:
                found.append(_Sign(text, box.left - left, box.right - left, top - y.value, size))
    finally:
        layer.close()
    return found


def _rows(signs: list[_Sign]) -> list[list[_Sign]]:
    """Return the characters of each baseline, from the top down, left to right."""
    rows: list[list[_Sign]] = []
    for sign in sorted(signs, key=lambda sign: sign.y):
        if rows and sign.y - rows[-1][0].y < _SAME_LINE * min(sign.size, rows[-1][0].size):
            rows[-1].append(sign)
        else:
            rows.append([sign])
    return [sorted(row, key=lambda sign: sign.left) for row in rows]


def _cut(rows: list[list[_Sign]]) -> list[list[list[_Sign]]]:
    """Return rows cut where columns or cells of a table part: at wide gaps, at narrower ones that
    end where wide ones of two rows around do, and before figures that end below each other."""
    gaps = [list(_gaps(row)) for row in rows]
    wide = [[sign.left for sign, gap in row if gap > _APART] for row in gaps]
    words = [
        _split(row, {sign for sign, gap in of_row if gap > _SPACE})
        for row, of_row in zip(rows, gaps, strict=True)
    ]
    ends = [[word[-1].right for word in row[1:] if _is_figure(word)] for row in words]
    found = []
    for number, row in enumerate(rows):
        near, ends_near = _around(wide, number), _around(ends, number)
        cuts = {
            sign
            for sign, gap in gaps[number]
            if gap > _APART or (gap > _NARROW and _aligned(sign.left, near, _ALIGNED * sign.size))
        }
        below = [
            word
            for word in words[number][1:]
            if _aligned(word[-1].right, ends_near, _EXACT * word[0].size)
        ]
        if len(below) >= _COLUMNS or (wide[number] and all(map(_is_figure, below))):
            cuts |= {word[0] for word in below}
        found.append(_split(row, cuts))
    return found


def _around(places: list[list[float]], number: int) -> list[list[float]]:
    """Return the places in the rows above and below one."""
    return places[max(0, number - _NEAR) : number] + places[number + 1 : number + 1 + _NEAR]


def _aligned(place: float, others: list[list[float]], near: float) -> bool:
    """Return whether a place is that of one in enough other rows."""
    return sum(any(abs(each - place) < near for each in row) for row in others) >= _ALIKE


def _split(row: list[_Sign], cuts: set[_Sign]) -> list[list[_Sign]]:
    """Return a row in pieces that begin with some of its characters."""
    pieces = [[row[0]]]
    for sign in row[1:]:
        if sign in cuts:
            pieces.append([])
        pieces[-1].append(sign)
    return pieces


def _is_figure(word: list[_Sign]) -> bool:
    text = "".join(sign.text for sign in word)
    return any(map(str.isdecimal, text)) and not any(map(str.isalpha, text))


def _gaps(row: list[_Sign]) -> Iterator[tuple[_Sign, float]]:
    """Yield the characters of a row but the first, with the gap before each, in sizes."""
    right = row[0].right
    for before, sign in itertools.pairwise(row):
        right = max(right, before.right)
        yield sign, (sign.left - right) / max(before.size, sign.size)


def _whole_tables(rows: list[list[list[_Sign]]]) -> list[list[list[_Sign]]]:
    """Return the rows with those of tables as one piece, their cells parted by semicolons."""
    found: list[list[list[_Sign]]] = []
    for are_cells, parts in itertools.groupby(_parts(rows), key=lambda part: part[0]):
        same = [row for _, part in parts for row in part]
        if not are_cells or len(same) < _TABLE_ROWS:
            found += same
            continue
        for row in same:
            whole = list(row[0])
            for cell in row[1:]:
                end = whole[-1]
                whole.append(_Sign(";", end.right, end.right, end.y, end.size))
                whole += cell
            found.append([whole])
    return found


def _parts(rows: list[list[list[_Sign]]]) -> Iterator[tuple[bool, list[list[list[_Sign]]]]]:
    """Yield rows at even distances, each with whether its pieces are as short as cells."""
    for is_cut, group in itertools.groupby(rows, key=lambda row: len(row) > 1):
        same = list(group)
        steps = np.diff([row[0][0].y for row in same])
        far = steps > _FARTHER * np.median(steps) if len(steps) else steps
        ends = [0, *(np.flatnonzero(far) + 1).tolist(), len(same)]
        for begin, end in itertools.pairwise(ends):
            part = same[begin:end]
            cells = [cell for row in part for cell in row]
            words = sum(len(_words(cell).split()) for cell in cells) / len(cells)
            yield is_cut and words <= _CELL_WORDS, part


def _words(piece: list[_Sign]) -> str:
    """Return the text of a piece, from the right if its script is written so."""
    letters = [unicodedata.bidirectional(sign.text[0]) for sign in piece]
    leftward = sum(each in ("R", "AL") for each in letters) > sum(each == "L" for each in letters)
    signs = piece[::-1] if leftward else piece
    text = signs[0].text
    for before, sign in itertools.pairwise(signs):
        gap = before.left - sign.right if leftward else sign.left - before.right
        text += (" " if gap > _SPACE * sign.size else "") + sign.text
    return unicodedata.normalize("NFC", text)


def _line(piece: list[_Sign], point_mm: float) -> TextLine:
    size = float(np.median([sign.size for sign in piece])) * point_mm
    return TextLine(
        left_mm=min(sign.left for sign in piece) * point_mm,
        right_mm=max(sign.right for sign in piece) * point_mm,
        baseline=(piece[0].y * point_mm,),
        x_height_mm=_X_HEIGHT * size,
        ascent_mm=_ASCENT * size,
        descent_mm=_DESCENT * size,
        cell=int(any(sign.left == sign.right for sign in piece)),
    )


def _makes_sense(text: str) -> bool:
    """Return whether a layer is text: not empty, and not of unknown or wrong codes."""
    if not text:
        return False
    unknown = sum(unicodedata.category(each)[0] == "C" or each == "\ufffd" for each in text)
    if unknown > _MOST_UNKNOWN * len(text):
        return False
    # Accents are marks of their own here.
    plain = unicodedata.normalize("NFD", text.lower())
    latin = [each for each in plain if each.isalpha() and "LATIN" in unicodedata.name(each, "")]
    share = sum(each in _VOWELS for each in latin) / max(1, len(latin))
    return len(latin) < _FEWEST or _VOWEL_SHARE[0] < share < _VOWEL_SHARE[1]


def _is_mostly_picture(sheet: "pypdfium2.PdfPage") -> bool:
    """Return whether one picture covers much of a page."""
    import pypdfium2.raw as pdfium

    width, height = sheet.get_size()
    for picture in sheet.get_objects(filter=[pdfium.FPDF_PAGEOBJ_IMAGE]):
        left, bottom, right, top = picture.get_bounds()
        if (right - left) * (top - bottom) > _PICTURE * width * height:
            return True
    return False
