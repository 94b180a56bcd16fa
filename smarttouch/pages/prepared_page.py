"""Pages ready to be read: straight, dark on white, their lines in order and cut out as strips."""

import math
import textwrap
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.errors import PageError
from smarttouch.pages.page_image import INCH_MM, Page, TextLine, require_size_mm
from smarttouch.pages.reading_order import DOUBTFUL
from smarttouch.pages.straighten import LAID_FLAT, find_sheet, flattened
from smarttouch.pages.text_lines import page_lines

_AROUND = 0.8  # extent of the page considered above and below a line, in heights of the line
SIDES = 0.25  # paper kept before and after a line, in heights of the line
_INK = 128  # level below which is ink, when the spots of neighboring lines are located
_FADED = 2  # samples by which the grey edge of a spot reaches beyond its ink


def cut_strip(
    cleaned: NDArray[np.uint8], mm_per_pixel: float, line: TextLine, height_px: int
) -> NDArray[np.uint8]:
    """Return a line cut out of a page and straightened along its baseline, (height_px, W) uint8.

    Its print, from ascenders to descenders, fills the height; `SIDES` of paper stay at each end.
    What reaches in from the lines above and below is left out.
    """
    line_px = line.height_mm / mm_per_pixel
    # A smaller strip is sampled as finely as the page, then averaged.
    steps = max(1, math.ceil(line_px / height_px))
    rows = steps * height_px
    scale_mm = line.height_mm / rows
    sides_mm, above = SIDES * line.height_mm, round(_AROUND * rows)
    width = max(1, round((line.right_mm - line.left_mm + 2 * sides_mm) / scale_mm / steps))
    along_mm = np.asarray(
        line.left_mm - sides_mm + (np.arange(width * steps) + 0.5) * scale_mm, np.float64
    )
    across_mm = (np.arange(-above, rows + above) + 0.5) * scale_mm - line.ascent_mm
    # Columns are not tilted: strokes stay upright on a curved page.
    x_mm = np.broadcast_to(along_mm, (len(across_mm), len(along_mm)))
    y_mm = line.baseline_mm(along_mm) + across_mm[:, None]
    wide = cv2.remap(
        cleaned,
        np.asarray(x_mm / mm_per_pixel - 0.5, np.float32),
        np.asarray(y_mm / mm_per_pixel - 0.5, np.float32),
        cv2.INTER_CUBIC if rows > line_px else cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=255,
    )
    strip = _without_neighbors(np.asarray(wide, np.uint8), above, rows)
    return np.asarray(cv2.resize(strip, (width, height_px), interpolation=cv2.INTER_AREA), np.uint8)


def _without_neighbors(wide: NDArray[np.uint8], above: int, rows: int) -> NDArray[np.uint8]:
    """Return the middle rows of a wider cut, without spots whose center is beyond them."""
    ink = (wide < _INK).view(np.uint8)
    _, labels, _, centers = cv2.connectedComponentsWithStats(ink, connectivity=8)
    is_foreign = np.abs(centers[:, 1] - above - rows / 2) > rows / 2
    is_foreign[0] = False
    spots = is_foreign.astype(np.uint8)[labels]
    faded = cv2.dilate(spots, np.ones((2 * _FADED + 1,) * 2, np.uint8)) > 0
    # Ink of this line nearby is kept.
    cut = np.where(faded & ((labels == 0) | (spots > 0)), np.uint8(255), wide)
    return cut[above : above + rows]


LEFT_OUT = "left out: "  # beginning of the note on what is not among the lines
FAINT = "faint marks, as of print on the back of the sheet"


@dataclass(frozen=True, eq=False)
class PreparedPage:
    """Page straightened and cleaned to dark on white, its paper 255, with lines in reading
    order.
    """

    page: Page
    cleaned: NDArray[np.uint8]
    lines: tuple[TextLine, ...]
    light_on_dark: bool
    notes: tuple[str, ...]
    words: tuple[str, ...] = ()  # words of each line, where the page brings them
    known: dict[int, tuple[str, float]] = field(default_factory=dict)
    """Text of lines that were recognized already, with a confidence in [0, 1]."""

    def strip(self, index: int, height_px: int) -> NDArray[np.uint8]:
        """Return a line straightened, (height_px, W) uint8, ascenders to descenders filling it."""
        return cut_strip(self.cleaned, self.page.mm_per_pixel, self.lines[index], height_px)


def prepare_page(
    page: Page,
    light_on_dark: bool | None = None,
    leftward: bool = False,
) -> PreparedPage:
    """Prepare a scan, photograph or picture of print for reading, detecting its polarity if not
    given; columns of ``leftward`` scripts are read from the right.
    """
    notes: list[str] = []
    corners = find_sheet(page.grey)
    if corners is not None:
        page = Page(flattened(page.grey, corners), page.mm_per_pixel)
        notes.append(LAID_FLAT)
    found = page_lines(page, light_on_dark, leftward, turn=True)
    if found.skew_deg:
        notes.append(f"the text was tilted by {abs(found.skew_deg):.1f}° and was turned level")
    if found.is_doubtful:
        notes.append(DOUBTFUL)
    paper = found.paper
    left_out = [words for words in (found.left_out, FAINT if paper.faint else "") if words]
    if left_out:
        notes.append(LEFT_OUT + ", ".join(left_out))
    return PreparedPage(
        found.page, paper.cleaned, tuple(found.lines), paper.light_on_dark, tuple(notes)
    )


PRINT_DPI = 300
_WIDTH_MM, _MARGIN_MM, _LINE_MM, _STEP_MM = 92.0, 7.0, 4.2, 8.0
"""Printed page, its margins, its lines from ascender to descender, and their distance."""
_COLUMNS = 30
_INK_LEVEL = 15
_PER_MM = PRINT_DPI / INCH_MM


def print_text(text: str) -> Page:
    """Print a text as black on white at 300 dots per inch; the page has its lines and words."""
    wrapped = [row for part in text.splitlines() for row in textwrap.wrap(part, _COLUMNS) or [""]]
    if not any(wrapped):
        raise PageError("text: has no words: give some after the colon")
    height_mm = 2 * _MARGIN_MM + (len(wrapped) - 1) * _STEP_MM + _LINE_MM
    require_size_mm(
        f"the text of {len(wrapped)} lines", _WIDTH_MM, height_mm, "shorter text, or a page"
    )
    sheet = Image.new("L", (round(_WIDTH_MM * _PER_MM), round(height_mm * _PER_MM)), 255)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=_LINE_MM * _PER_MM * 1.26)
    # Heights above the baseline.
    high, low, x_high = (-font.getbbox(signs, anchor="ls")[k] / _PER_MM
                         for signs, k in (("dlA", 1), ("gpy", 3), ("x", 1)))  # fmt: skip
    lines = []
    for number, row in enumerate(wrapped):
        baseline_mm = _MARGIN_MM + number * _STEP_MM + font.getbbox("x")[3] / _PER_MM
        origin = _MARGIN_MM * _PER_MM, baseline_mm * _PER_MM
        draw.text(origin, row, fill=_INK_LEVEL, font=font, anchor="ls")
        if row:
            left, _, right, _ = (side / _PER_MM for side in font.getbbox(row))
            lines.append(TextLine(
                _MARGIN_MM + left, _MARGIN_MM + right, (baseline_mm,), x_high, high, -low
            ))  # fmt: skip
    words = tuple(row.strip() for row in wrapped if row)
    return Page(np.asarray(sheet), 1 / _PER_MM, tuple(lines), words)


def prepare_text(text: str) -> PreparedPage:
    """Print a text and return it ready to be read, with its known lines."""
    page = print_text(text)
    return PreparedPage(page, page.grey, page.lines, False, (), page.words)
