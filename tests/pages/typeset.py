"""Pages typeset with columns, boxes, pictures, rules, tables, drop caps; their order is known."""

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from .printed import INCH_MM, INK, PAPER, WORDS, _font

DPI = 200
_PT = DPI / 72
_SIZE = 10 * _PT
_STEP = 1.25 * _SIZE
_MARGIN, _GUTTER, _WIDTH, _HEIGHT = 90, 45, 1300, 1500
HEBREW = ["האדם", "מניח", "את", "ידו", "על", "הנייר", "ויודע", "אם", "הוא", "חלק", "או", "גס"]


@dataclass(frozen=True)
class Piece:
    """A line of text, or the cell of a table: its words, its box and its baseline, px."""

    text: str
    left: float
    right: float
    y: float
    size: float


class Sheet:
    """Sheet of paper on which text is set; `pieces` are in the order in which they are read."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.image = Image.new("L", (_WIDTH, _HEIGHT), PAPER)
        self.draw = ImageDraw.Draw(self.image)
        self.pieces: list[Piece] = []
        self.words = WORDS
        self.font = "DejaVuSerif"

    @property
    def grey(self):
        """The sheet, (H, W) uint8."""
        return np.asarray(self.image)

    @property
    def text(self):
        """All of its text, a line for each piece."""
        return "\n".join(piece.text for piece in self.pieces)

    def line(self, text, x, y, size=_SIZE, font=None, before=""):
        """Print a line; ``before`` are letters printed already that belong to its first word."""
        face = _font(font or self.font, size)
        self.draw.text((round(x), round(y)), text, fill=INK, font=face, anchor="ls")
        left, _, right, _ = face.getbbox(text, anchor="ls")
        self.pieces.append(Piece(before + text, x + left, x + right, y, size))

    def column(self, x, y, width, lines, size=_SIZE, first=None, leftward=False):
        """Print lines of words, ragged, from a baseline; return the next one's.

        ``first`` gives the indent of each line, and what stands before the first one.
        """
        face = _font(self.font, size)
        for number in range(lines):
            indent, before = first(number) if first else (0, "")
            words = [str(self.random.choice(self.words))]
            if before:
                words = [words[0].lower()]
            while face.getlength(" ".join(words)) < width - indent:
                words.append(str(self.random.choice(self.words)))
            text = " ".join(words[:-1]) or words[0]
            if number == lines - 1:
                text = " ".join(words[: max(1, len(words) // 2)])
            at = x + width - face.getlength(text) if leftward else x + indent
            self.line(text, at, y, size, before=before)
            y += 1.25 * size
        return y

    def table(self, x, y, widths, rows):
        """Print a table of names and figures, by rows; the figures end below each other."""
        face = _font(self.font, _SIZE)
        for number in range(rows):
            cells = [str(self.random.choice(WORDS)).strip(",;()").capitalize() or "Sum"]
            cells += [f"{self.random.integers(10, 9999) / 10:.1f}" for _ in widths[1:]]
            if not number:
                cells = ["Name", *(f"{1990 + 7 * k}" for k in range(len(widths) - 1))]
            left = x
            for k, (text, width) in enumerate(zip(cells, widths, strict=True)):
                self.line(text, left + (width - face.getlength(text) if k else 0), y)
                left += width
            y += _STEP
        return y


_HALF = (_WIDTH - 2 * _MARGIN - _GUTTER) // 2
_RIGHT = _MARGIN + _HALF + _GUTTER
_FULL = _WIDTH - 2 * _MARGIN


def _headline(sheet, y=150.0):
    sheet.line("Of hands and pages", _MARGIN, y, 2 * _SIZE, "DejaVuSerif-Bold")
    return y + 3 * _STEP


def plain(sheet):
    """One column of three paragraphs under a headline."""
    y = _headline(sheet)
    for lines in (6, 9, 7):
        y = sheet.column(_MARGIN, y, _FULL, lines, first=lambda k: (0 if k else 40, ""))


def two_columns(sheet):
    """Two columns under a headline."""
    y = _headline(sheet)
    for x in (_MARGIN, _RIGHT):
        sheet.column(x, y, _HALF, 25)


def three_columns(sheet):
    """Three columns of smaller print, of different lengths."""
    y, width = _headline(sheet), (_FULL - 2 * _GUTTER) // 3
    for k, lines in enumerate((28, 28, 17)):
        sheet.column(_MARGIN + k * (width + _GUTTER), y, width, lines, 8 * _PT)


def box(sheet):
    """Two columns, in the first of which a box stands."""
    y = sheet.column(_MARGIN, 150, _HALF, 9)
    lower = y + 8 * _STEP
    sheet.column(_MARGIN, lower, _HALF, 9)
    sheet.draw.rectangle((_MARGIN, y, _MARGIN + _HALF, lower - 2 * _STEP), outline=INK, width=3)
    sheet.column(_MARGIN + 30, y + 1.6 * _STEP, _HALF - 60, 4)
    sheet.column(_RIGHT, 150, _HALF, 26)


def caption(sheet):
    """Two columns, in the second of which a picture stands with a caption of smaller print."""
    sheet.column(_MARGIN, 150, _HALF, 28)
    y = sheet.column(_RIGHT, 150, _HALF, 6)
    top, bottom = round(y), round(y + 250)
    sheet.draw.rectangle((_RIGHT, top, _RIGHT + _HALF, bottom), fill=90)
    for _ in range(12):
        x, side = _RIGHT + 20 + sheet.random.integers(0, _HALF - 120), sheet.random.integers(20, 90)
        at = top + 20 + sheet.random.integers(0, 130)
        sheet.draw.ellipse((x, at, x + side, at + side), fill=int(sheet.random.integers(40, 200)))
    sheet.column(_RIGHT, bottom + 180, _HALF, 8)
    sheet.column(_RIGHT, bottom + 40, _HALF, 3, 8 * _PT)


def rule(sheet):
    """Two articles of two columns, parted by a printed rule."""
    for top in (150, 750):
        for x in (_MARGIN, _RIGHT):
            sheet.column(x, top, _HALF, 12)
    sheet.draw.rectangle((_MARGIN, 645, _WIDTH - _MARGIN, 648), fill=INK)


def table_below(sheet):
    """A table of figures between two paragraphs."""
    y = sheet.column(_MARGIN, 150, _FULL, 6)
    y = sheet.table(_MARGIN + 60, y + 2 * _STEP, (300, 180, 180, 180), 9)
    sheet.column(_MARGIN, y + 2 * _STEP, _FULL, 6)


def table_beside(sheet):
    """A column of text, and beside it a table of figures with text below."""
    sheet.column(_MARGIN, 150, _HALF, 26)
    y = sheet.table(_RIGHT, 150, (200, 110, 110, 110), 10)
    sheet.column(_RIGHT, y + 2 * _STEP, _HALF, 10)


def drop_caps(sheet):
    """Two columns, each of which begins with a letter of three lines."""
    face = _font("DejaVuSerif", 4.1 * _SIZE)
    for x, letter in ((_MARGIN, "T"), (_RIGHT, "B")):
        sheet.draw.text((x, 150 + 2 * _STEP), letter, fill=INK, font=face, anchor="ls")
        indent = face.getlength(letter) + 8

        def first(number, indent=indent, letter=letter):
            return (indent if number < 3 else 0), ("" if number else letter)

        sheet.column(x, 150, _HALF, 24, first=first)


def leftward(sheet):
    """Two columns of Hebrew, read from the right."""
    sheet.words, sheet.font = HEBREW, "DejaVuSans"
    for x in (_RIGHT, _MARGIN):
        sheet.column(x, 150, _HALF, 20, leftward=True)


def cast(sheet):
    """Roles and names, joined by leaders, under a headline."""
    _headline(sheet)
    face = _font(sheet.font, _SIZE)
    for row in range(12):
        y = 300 + 1.4 * _STEP * row
        role, name = (f"{sheet.random.choice(WORDS).strip(',;()')} of Hands" for _ in range(2))
        start, end = _MARGIN + face.getlength(role), _WIDTH - _MARGIN - face.getlength(name)
        for x in range(round(start) // 16 * 16 + 32, round(end) - 16, 16):
            sheet.draw.text((x, y), ".", fill=INK, font=face, anchor="ls")
        sheet.line(role, _MARGIN, y)
        sheet.line(name, end, y)


def index(sheet):
    """Three columns of short entries."""
    for x in (_MARGIN, _MARGIN + _FULL // 3, _MARGIN + 2 * _FULL // 3):
        for row in range(30):
            word = str(sheet.random.choice(WORDS)).strip(",;()").capitalize()
            sheet.line(f"{word}, {'12, 134, 270'[: 12 - 4 * (row % 3 > 1)]}", x, 150 + _STEP * row)


LAYOUTS = (
    plain, two_columns, three_columns, box, caption, rule, table_below, table_beside, drop_caps,
    leftward,
)  # fmt: skip
MM_PER_PIXEL = INCH_MM / DPI


def typeset(layout, seed):
    """Return a sheet of a layout, with other words for each seed."""
    sheet = Sheet(seed)
    layout(sheet)
    return sheet


def found_order(pieces, lines):
    """Return for each piece the place of the line in which its middle lies, (N,); -1 for none.

    ``lines`` are (left, right, baseline at x), px, in the order in which they were found.
    """
    order = np.full(len(pieces), -1)
    for k, piece in enumerate(pieces):
        x = (piece.left + piece.right) / 2
        for place, (left, right, at) in enumerate(lines):
            if left <= x <= right and abs(at(x) - piece.y) < 0.4 * piece.size:
                order[k] = place
                break
    return order


def prepared_order(sheet, prepared):
    """Return the same of a prepared page that was not turned."""
    px = MM_PER_PIXEL
    lines = [
        (line.left_mm / px, line.right_mm / px,
         lambda x, line=line: float(line.baseline_mm(np.array([x * px]))[0]) / px)
        for line in prepared.lines
    ]  # fmt: skip
    return found_order(sheet.pieces, lines)
