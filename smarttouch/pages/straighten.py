"""Straightening of pages: a photographed sheet seen from above, text turned level."""

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.ink import Grey

Corners = NDArray[np.float64]

_SIDE_PX = 480  # longer side of the image in which a sheet is detected
_LEAST_PART = 0.2  # least part of the photograph covered by a sheet
_LARGEST_PART = 0.97  # part above which the image is the sheet itself, scanned
_LOG_STEPS = (0.1, 0.15, 0.25, 0.4, 0.7)
"""Least steps, in logarithms of the level, of edges that enclose a sheet; shadows' are lower."""
_LEAST_FILLED = 0.93  # least common part of the quadrilateral and the bright area
_LEAST_STEP = 25.0
"""Least drop in grey level from the paper to its background, across each visible edge."""
_EDGE_PX = 6.0  # distance from an edge at which both sides of it are compared, in that image
_LEAST_SIDES = 3  # fewest visible edges; the fourth may be the edge of the photograph
_ROUGH = 0.02  # tolerance of an outline with four corners, as a part of its length
_INSET = 0.006  # part of the sheet left out at its blurred edges


def find_sheet(grey: Grey) -> Corners | None:
    """Return the corners of a bright sheet, (4, 2) px, clockwise from the top left, or None."""
    factor = _SIDE_PX / max(grey.shape)
    size = (max(8, round(grey.shape[1] * factor)), max(8, round(grey.shape[0] * factor)))
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Print on the sheet is bridged first.
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))
    paper = np.asarray(cv2.morphologyEx(small, cv2.MORPH_CLOSE, around), np.uint8)
    largest = 0.0
    corners_found: Corners | None = None
    for mask in _areas(paper):
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not outlines:
            continue
        outline = np.asarray(max(outlines, key=cv2.contourArea), np.int32)
        covered = cv2.contourArea(outline)
        if not max(_LEAST_PART * small.size, largest) < covered < _LARGEST_PART * small.size:
            continue
        corners = _quadrilateral(outline)
        # A sheet that is lit in part only is the largest that is found.
        if corners is not None and _is_sheet(corners, outline, paper):
            largest = covered
            corners_found = np.asarray((corners + 0.5) / factor)
    return corners_found


def _areas(paper: Grey) -> Iterator[Grey]:
    """Yield areas that may be a sheet: enclosed by sharp edges, as the edges of shadows are not."""
    square = np.ones((3, 3), np.uint8)
    edges = cv2.morphologyEx(np.log(paper + np.float32(8)), cv2.MORPH_GRADIENT, square)
    for step in _LOG_STEPS:
        _, labels, boxes, _ = cv2.connectedComponentsWithStats((edges < step).astype(np.uint8))
        for k in np.argsort(-boxes[1:, cv2.CC_STAT_AREA])[:2] + 1:
            yield np.asarray(cv2.dilate((labels == k).astype(np.uint8), square), np.uint8)


def flattened(grey: Grey, corners: Corners) -> Grey:
    """Return a sheet as seen from straight above, at its finest resolution."""
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


def _quadrilateral(outline: NDArray[np.int32]) -> Corners | None:
    """Return the corners of an outline that has four, clockwise from the top left."""
    hull = cv2.convexHull(outline)
    corners = cv2.approxPolyDP(hull, _ROUGH * cv2.arcLength(hull, True), True).reshape(-1, 2)
    if len(corners) != 4:
        return None
    return np.roll(corners, -int(corners.sum(axis=1).argmin()), axis=0).astype(np.float64)


def _is_sheet(corners: Corners, outline: NDArray[np.int32], paper: Grey) -> bool:
    """Return whether four corners are those of a sheet with a darker background."""
    area = cv2.contourArea(corners.astype(np.float32))
    sides = np.roll(corners, -1, axis=0) - corners
    filled = cv2.contourArea(outline) / max(area, 1.0)
    if abs(filled - 1) > 1 - _LEAST_FILLED:
        return False
    seen = 0
    for corner, side in zip(corners, sides, strict=True):
        along = corner + np.linspace(0.1, 0.9, 40)[:, None] * side
        outwards = np.array([side[1], -side[0]]) / np.hypot(*side)
        at = np.rint(along + np.array([_EDGE_PX, -_EDGE_PX])[:, None, None] * outwards).astype(int)
        within = ((at >= 0) & (at < paper.shape[::-1])).all(axis=(0, 2))
        if within.mean() < 0.5:
            continue
        column, row = at[:, within].transpose(2, 0, 1)
        outside, inside = paper[row, column].astype(np.float64)
        if np.percentile(inside - outside, 20) < _LEAST_STEP:
            return False
        seen += 1
    return seen >= _LEAST_SIDES


LAID_FLAT = "the sheet of paper was cut out of the photograph and laid flat"
"""Note of a sheet that was found."""
_SKEWS_DEG = np.linspace(-16, 16, 321)
_LEAST_SKEW_DEG, _PEAK_DEG = 0.2, 0.6  # below, lines are followed; half of a peak's width
_BIN, _FEWEST, _SURE = 0.25, 30, 2.0
"""Height of the bins that count the lower ends of letters, in letter heights; fewest letters, and
least ratio to the usual skew's count, that determine a skew."""


def skew_of(x: NDArray[np.float64], bottom: NDArray[np.float64], height: float) -> float:
    """Return the clockwise skew in degrees at which most lower ends of letters, (N,) px, are in
    line; 0 if it is not certain."""
    if len(x) < _FEWEST:
        return 0.0
    rows = (bottom - np.tan(np.radians(_SKEWS_DEG))[:, None] * x) / (_BIN * height)
    rows = (rows - rows.min()).astype(int)
    count = np.array([float(np.square(np.bincount(row)).sum()) for row in rows])
    near = np.abs(_SKEWS_DEG - _SKEWS_DEG[count.argmax()]) < _PEAK_DEG
    skew_deg = np.average(_SKEWS_DEG, weights=near * np.maximum(count - 0.7 * count.max(), 0))
    sure = count.max() > _SURE * np.median(count)
    return float(skew_deg) if sure and abs(skew_deg) >= _LEAST_SKEW_DEG else 0.0


def turned(grey: Grey, skew_deg: float) -> Grey:
    """Rotate a page back; it grows, and the new area is filled with its paper."""
    height, width = grey.shape
    angle = math.radians(skew_deg)
    cos, sin = math.cos(angle), abs(math.sin(angle))
    size = (math.ceil(width * cos + height * sin), math.ceil(height * cos + width * sin))
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), skew_deg, 1)
    matrix[:, 2] += (size[0] - width) / 2, (size[1] - height) / 2
    paper = float(np.median(grey))
    return np.asarray(
        cv2.warpAffine(grey, matrix, size, flags=cv2.INTER_CUBIC, borderValue=paper), np.uint8
    )
