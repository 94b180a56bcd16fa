"""Correction of perspective and skew in pictures of pages; lines cut out as straight strips."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.ink import Grey
from smarttouch.pages.page_and_lines import TextLine

Corners = NDArray[np.float64]

_SIDE_PX = 480  # longer side of the image for sheet detection
_LEAST_PART = 0.2  # smallest share of a photograph that a sheet covers
_LARGEST_PART = 0.97  # if a sheet covers a larger share of a picture, the picture is a scan
_LOG_STEPS = (0.1, 0.15, 0.25, 0.4, 0.7)
"""Smallest steps of log gray level at edges. Low limits find faint edges, high ones no shadows."""
_LEAST_FILLED = 0.93  # smallest share of a sheet's quadrilateral that is bright
_LEAST_STEP = 25.0  # smallest drop of the gray level from sheet to background at a visible edge
_LEAST_SIDES = 3  # smallest number of visible edges; one edge may be outside the photograph
_EDGE_PX = 6  # distance from an edge at which paper and background are compared
_ROUGH = 0.02  # largest deviation from a quadrilateral, relative to the length of the outline
_INSET = 0.006  # share of a sheet's width and height that is cut off, because the edges are blurred


def find_sheet(grey: Grey) -> Corners | None:
    """Return the corners of a bright sheet, (4, 2) px, clockwise from the top left, or None."""
    factor = _SIDE_PX / max(grey.shape)
    size = (max(8, round(grey.shape[1] * factor)), max(8, round(grey.shape[0] * factor)))
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Remove the print on the sheet first.
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))
    paper = np.asarray(cv2.morphologyEx(small, cv2.MORPH_CLOSE, around), np.uint8)
    square = np.ones((3, 3), np.uint8)
    edges = cv2.morphologyEx(np.log(paper + np.float32(8)), cv2.MORPH_GRADIENT, square)
    largest, found = _LEAST_PART * small.size, None
    for step in _LOG_STEPS:
        calm = (edges < step).view(np.uint8)
        for outline in cv2.findContours(calm, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
            covered = cv2.contourArea(outline)
            # Take the largest area: a brightly lit part of the sheet may have edges, too.
            if largest < covered < _LARGEST_PART * small.size:
                hull = cv2.convexHull(outline)
                corners = cv2.approxPolyDP(hull, _ROUGH * cv2.arcLength(hull, True), True)[:, 0]
                if len(corners) == 4 and _is_sheet(corners.astype(float), covered, paper):
                    largest, found = covered, corners
    if found is None:
        return None
    found = np.roll(found, -int(found.sum(axis=1).argmin()), axis=0)
    middle = found.mean(axis=0)
    return np.asarray((middle + (1 - _INSET) * (found - middle) + 0.5) / factor)


def _is_sheet(corners: Corners, covered: float, paper: Grey) -> bool:
    """Return whether four corners enclose a sheet on a darker background."""
    if abs(covered / cv2.contourArea(corners.astype(np.float32)) - 1) > 1 - _LEAST_FILLED:
        return False
    padded = np.pad(paper, _EDGE_PX, mode="edge").astype(np.float64)
    sides = (np.roll(corners, -1, axis=0) - corners)[:, None]
    along = corners[:, None] + np.linspace(0.1, 0.9, 40)[:, None] * sides + _EDGE_PX
    across = _EDGE_PX * sides[..., ::-1] * (1, -1) / np.hypot(*sides.T).T[..., None]
    outside, inside = (
        padded[tuple(np.rint(along + off).astype(int).T[::-1])] for off in (across, -across)
    )
    steps = np.percentile(inside - outside, 20, axis=0)
    return bool(np.count_nonzero(steps >= _LEAST_STEP) >= _LEAST_SIDES)


def flattened(grey: Grey, corners: Corners) -> Grey:
    """Stretch a quadrilateral of a picture to a rectangle. It is as wide as the longer of the
    top and bottom sides, and as high as the longer of the left and right sides. Areas outside
    the picture get the picture's median gray level."""
    top, right, bottom, left = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    width, height = max(2, round(max(top, bottom))), max(2, round(max(left, right)))
    target = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), target)
    paper = float(np.median(grey[::4, ::4]))
    flat = cv2.warpPerspective(
        grey, matrix, (width, height), flags=cv2.INTER_CUBIC, borderValue=paper
    )
    return np.asarray(flat, np.uint8)


def turned(grey: Grey, skew_deg: float) -> Grey:
    """Rotate a page to correct its skew. The page becomes larger, so that nothing is cut off."""
    size, angle = np.array(grey.shape[::-1]), math.radians(skew_deg)
    axes = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    half = np.abs(axes) @ size / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ axes
    return flattened(grey, corners + (size - 1) / 2)


_AROUND = 0.8  # margin above and below a line, in line heights; removed after straightening
SIDES = 0.25  # margin before and after a line, in line heights
_INK = 128  # gray level below which a pixel belongs to a spot of ink
_FADED = np.ones((5, 5), np.uint8)  # dilation kernel that extends a spot by its gray edge


def cut_strip(cleaned: Grey, mm_per_pixel: float, line: TextLine, height_px: int) -> Grey:
    """Return the picture of a line, (height_px, W) uint8, straightened along its baseline.

    The picture reaches from ascenders to descenders, with `SIDES` as margin at each end. Ink of the
    lines above and below is removed.
    """
    # Cut the line out at the resolution of the page; scale it to ``height_px`` at the end.
    rows = max(1, round(line.height_mm / mm_per_pixel))
    scale_mm, sides_mm, above = line.height_mm / rows, SIDES * line.height_mm, round(_AROUND * rows)
    columns = max(1, round((line.right_mm - line.left_mm + 2 * sides_mm) / scale_mm))
    along_mm = line.left_mm - sides_mm + (np.arange(columns) + 0.5) * scale_mm
    across_mm = (np.arange(-above, rows + above) + 0.5) * scale_mm - line.ascent_mm
    # Shift columns of pixels only vertically, so that strokes stay upright on a curved page.
    y_mm = line.baseline_mm(np.asarray(along_mm, np.float64)) + across_mm[:, None]
    x, y = ((mm / mm_per_pixel - 0.5).astype(np.float32)
            for mm in (np.broadcast_to(along_mm, y_mm.shape), y_mm))  # fmt: skip
    strip = np.asarray(cv2.remap(cleaned, x, y, cv2.INTER_CUBIC, borderValue=255), np.uint8)
    ink = (strip < _INK).view(np.uint8)
    _, labels, _, centers = cv2.connectedComponentsWithStats(ink, connectivity=8)
    is_foreign = np.abs(centers[:, 1] - len(strip) / 2) > rows / 2
    is_foreign[0] = False
    spots = is_foreign[labels]
    # Erase spots of other lines and the gray edges of these spots, but no ink of this line.
    strip[(cv2.dilate(spots.view(np.uint8), _FADED) > 0) & (spots | (labels == 0))] = 255
    size = (max(1, round(columns * height_px / rows)), height_px)
    smooth = cv2.INTER_AREA if height_px < rows else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(strip[above : above + rows], size, interpolation=smooth), np.uint8)
