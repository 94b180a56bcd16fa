"""Pages prepared for reading: straight, dark on white, with lines in order, and strips of lines."""

import math
import textwrap
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.errors import PageError
from smarttouch.pages.ink import Grey
from smarttouch.pages.page_image import INCH_MM, Page, TextLine, require_size_mm
from smarttouch.pages.text_lines import page_lines

_AROUND = 0.8  # considered area above and below a line, in heights of the line
SIDES = 0.25  # margin before and after a line, in heights of the line
_INK = 128  # level of ink for spots of neighboring lines
_FADED = 2  # width of the gray edge of a spot, in samples


def cut_strip(cleaned: Grey, mm_per_pixel: float, line: TextLine, height_px: int) -> Grey:
    """Cut a line out of a page, straightened along its baseline, (height_px, W) uint8.

    The height is from ascenders to descenders; `SIDES` is the margin at each end. Parts of the
    lines above and below are removed.
    """
    line_px = line.height_mm / mm_per_pixel
    # Sample a small strip at the resolution of the page, then average.
    steps = max(1, math.ceil(line_px / height_px))
    rows = steps * height_px
    scale_mm = line.height_mm / rows
    sides_mm, above = SIDES * line.height_mm, round(_AROUND * rows)
    width = max(1, round((line.right_mm - line.left_mm + 2 * sides_mm) / scale_mm / steps))
    along_mm = np.asarray(
        line.left_mm - sides_mm + (np.arange(width * steps) + 0.5) * scale_mm, np.float64
    )
    across_mm = (np.arange(-above, rows + above) + 0.5) * scale_mm - line.ascent_mm
    # Do not tilt columns: strokes stay upright on a curved page.
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


def _without_neighbors(wide: Grey, above: int, rows: int) -> Grey:
    """Return the middle rows of a larger cut, without spots whose center is outside of them."""
    ink = (wide < _INK).view(np.uint8)
    _, labels, _, centers = cv2.connectedComponentsWithStats(ink, connectivity=8)
    is_foreign = np.abs(centers[:, 1] - above - rows / 2) > rows / 2
    is_foreign[0] = False
    spots = is_foreign.astype(np.uint8)[labels]
    faded = cv2.dilate(spots, np.ones((2 * _FADED + 1,) * 2, np.uint8)) > 0
    # Keep nearby ink of this line.
    cut = np.where(faded & ((labels == 0) | (spots > 0)), np.uint8(255), wide)
    return cut[above : above + rows]


Corners = NDArray[np.float64]

_SIDE_PX = 480  # longer side of the image for sheet detection
_LEAST_PART = 0.2  # smallest share of the photograph covered by a sheet
_LARGEST_PART = 0.97  # share above which the image is a scan
_LOG_STEPS = (0.1, 0.15, 0.25, 0.4, 0.7)
"""Smallest steps, in logarithm of the level, of the edges of a sheet; shadows have smaller ones."""
_LEAST_FILLED = 0.93  # smallest share of the quadrilateral that is bright
_LEAST_STEP = 25.0
"""Smallest drop of the gray level from paper to background at a visible edge."""
_EDGE_PX = 6  # distance from an edge at which its sides are compared
_LEAST_SIDES = 3  # smallest number of visible edges; others may be edges of the photograph
_ROUGH = 0.02  # tolerance of a quadrilateral outline, relative to its length
_SQUARE = np.ones((3, 3), np.uint8)
_INSET = 0.006  # share of the sheet removed at its blurred edges


def find_sheet(grey: Grey) -> Corners | None:
    """Return the corners of a bright sheet, (4, 2) px, clockwise from the top left, or None."""
    factor = _SIDE_PX / max(grey.shape)
    size = (max(8, round(grey.shape[1] * factor)), max(8, round(grey.shape[0] * factor)))
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Fill the print on the sheet first.
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))
    paper = np.asarray(cv2.morphologyEx(small, cv2.MORPH_CLOSE, around), np.uint8)
    edges = cv2.morphologyEx(np.log(paper + np.float32(8)), cv2.MORPH_GRADIENT, _SQUARE)
    largest, found = _LEAST_PART * small.size, None
    for step in _LOG_STEPS:
        _, labels, boxes, _ = cv2.connectedComponentsWithStats((edges < step).astype(np.uint8))
        for k in np.argsort(-boxes[1:, cv2.CC_STAT_AREA])[:2] + 1:
            area = cv2.dilate((labels == k).astype(np.uint8), _SQUARE)
            outlines, _ = cv2.findContours(area, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            outline = max(outlines, key=cv2.contourArea)
            covered = cv2.contourArea(outline)
            # Take the largest area, as a sheet may be partly lit.
            if largest < covered < _LARGEST_PART * small.size:
                hull = cv2.convexHull(outline)
                corners = cv2.approxPolyDP(hull, _ROUGH * cv2.arcLength(hull, True), True)[:, 0]
                if len(corners) == 4 and _is_sheet(corners.astype(float), covered, paper):
                    largest, found = covered, corners
    if found is None:
        return None
    return np.asarray((np.roll(found, -int(found.sum(axis=1).argmin()), axis=0) + 0.5) / factor)


def flattened(grey: Grey, corners: Corners) -> Grey:
    """Rectify a sheet, at its finest resolution."""
    middle = corners.mean(axis=0)
    corners = middle + (1 - _INSET) * (corners - middle)
    across, down = np.roll(corners, -1, axis=0) - corners, corners - np.roll(corners, 1, axis=0)
    width = max(2, round(max(math.hypot(*across[0]), math.hypot(*across[2]))))
    height = max(2, round(max(math.hypot(*down[0]), math.hypot(*down[2]))))
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), target)
    flat = cv2.warpPerspective(
        grey, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(flat, np.uint8)


def _is_sheet(corners: Corners, covered: float, paper: Grey) -> bool:
    """Return whether four corners enclose a sheet on a darker background."""
    if abs(covered / cv2.contourArea(corners.astype(np.float32)) - 1) > 1 - _LEAST_FILLED:
        return False
    around, seen = np.pad(paper, _EDGE_PX, mode="edge").astype(np.float64), 0
    for corner, side in zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True):
        along = corner + np.linspace(0.1, 0.9, 40)[:, None] * side + _EDGE_PX
        outwards = _EDGE_PX * np.array([side[1], -side[0]]) / np.hypot(*side)
        inside, outside = (
            around[tuple(np.rint(along + off).astype(int).T[::-1])] for off in (-outwards, outwards)
        )
        seen += np.percentile(inside - outside, 20) >= _LEAST_STEP
    return bool(seen >= _LEAST_SIDES)


LAID_FLAT = "the sheet of paper was cut out of the photograph and laid flat"
"""Note of a sheet that was found."""


@dataclass(frozen=True, eq=False)
class PreparedPage:
    """Straight page, dark on pure white, with lines in reading order."""

    page: Page
    cleaned: Grey
    lines: tuple[TextLine, ...]
    light_on_dark: bool
    notes: tuple[str, ...]
    words: tuple[str, ...] = ()  # text of each line, if the page provides it
    known: dict[int, tuple[str, float]] = field(default_factory=dict)
    """Texts of recognized lines, with confidences in [0, 1]."""

    def strip(self, index: int, height_px: int) -> Grey:
        """Return a straightened line, (height_px, W) uint8, from ascenders to descenders."""
        return cut_strip(self.cleaned, self.page.mm_per_pixel, self.lines[index], height_px)


def prepare_page(
    page: Page,
    light_on_dark: bool | None = None,
    leftward: bool = False,
) -> PreparedPage:
    """Prepare a scan, photograph or picture of print for reading; detect the polarity by default.
    Columns of ``leftward`` scripts are read from right to left."""
    notes: list[str] = []
    corners = find_sheet(page.grey)
    if corners is not None:
        page = Page(flattened(page.grey, corners), page.mm_per_pixel)
        notes.append(LAID_FLAT)
    found = page_lines(page, light_on_dark, leftward, turn=True)
    paper = found.paper
    notes += found.notes
    return PreparedPage(
        found.page, paper.cleaned, tuple(found.lines), paper.light_on_dark, tuple(notes)
    )


PRINT_DPI = 300
_WIDTH_MM, _MARGIN_MM, _LINE_MM, _STEP_MM = 92.0, 7.0, 4.2, 8.0
"""Printed page: width, margins, height of lines and line distance."""
_COLUMNS = 30
_INK_LEVEL = 15
_PER_MM = PRINT_DPI / INCH_MM


def print_text(text: str) -> Page:
    """Print a text black on white at 300 dots per inch; the page contains its lines and texts."""
    wrapped = [row for part in text.splitlines() for row in textwrap.wrap(part, _COLUMNS) or [""]]
    if not any(wrapped):
        raise PageError("text: has no words: give some after the colon")
    height_mm = 2 * _MARGIN_MM + (len(wrapped) - 1) * _STEP_MM + _LINE_MM
    require_size_mm(
        f"the text of {len(wrapped)} lines", _WIDTH_MM, height_mm, "shorter text, or a page"
    )
    sheet = Image.new("L", (round(_WIDTH_MM * _PER_MM), round(height_mm * _PER_MM)), 255)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=_LINE_MM * _PER_MM * 1.26)
    # heights above the baseline
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
    """Print a text and prepare the page, with its known lines."""
    page = print_text(text)
    return PreparedPage(page, page.grey, page.lines, False, (), page.words)
