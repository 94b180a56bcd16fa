"""Sheet of paper in a photograph: its four corners, and its view from above."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.ink import Grey

Corners = NDArray[np.float64]

_SIDE_PX = 480  # longer side of the image in which a sheet is detected
_LEAST_PART = 0.2  # least part of the photograph covered by a sheet
_MOST_PART = 0.97  # part above which the image is the sheet itself, scanned
_THRESHOLDS = (1.0, 0.75, 0.5)
"""Multiples of Otsu's threshold: a shadow on the sheet may be as dark as its background."""
_LEAST_FILLED = 0.93  # least common part of the quadrilateral and the bright area
_LEAST_STEP = 25.0
"""Least drop in grey level from the paper to its background, across each visible edge."""
_EDGE_PX = 6.0  # distance from an edge at which both sides of it are compared, in that image
_LEAST_SIDES = 3  # fewest visible edges; the fourth may be the edge of the photograph
_ROUGH = 0.02  # tolerance of an outline with four corners, as a part of its length
_LOOSE_PX = 5.0  # largest distance of a side's points from it, in that image
_INSET = 0.006  # part of the sheet left out at its blurred edges
_MOST_ANGLE = 35.0  # largest deviation of a corner from a right angle, in degrees


def find_sheet(grey: Grey) -> Corners | None:
    """Return the corners of a bright sheet, (4, 2) px, clockwise from the top left, or None."""
    factor = _SIDE_PX / max(grey.shape)
    size = (max(8, round(grey.shape[1] * factor)), max(8, round(grey.shape[0] * factor)))
    small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Print on the sheet is bridged first.
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (15, 15))
    paper = np.asarray(cv2.morphologyEx(small, cv2.MORPH_CLOSE, around), np.uint8)
    otsu, _ = cv2.threshold(paper, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    for part in _THRESHOLDS:
        _, bright = cv2.threshold(paper, part * otsu, 255, cv2.THRESH_BINARY)
        outlines, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        if not outlines:
            continue
        outline = np.asarray(max(outlines, key=cv2.contourArea), np.int32)
        if not _LEAST_PART < cv2.contourArea(outline) / small.size < _MOST_PART:
            continue
        corners = _quadrilateral(outline)
        if corners is not None and _is_sheet(corners, outline, paper):
            return np.asarray((corners + 0.5) / factor)
    return None


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
    """Return the corners of an outline that has four, each where two straight sides meet."""
    hull = cv2.convexHull(outline)
    length = cv2.arcLength(hull, True)
    rough = cv2.approxPolyDP(hull, _ROUGH * length, True).reshape(-1, 2).astype(np.float64)
    if len(rough) != 4:
        return None
    rough = rough[np.argsort(np.arctan2(*(rough - rough.mean(axis=0)).T[::-1]))]
    # Clockwise as seen, from the one nearest to the top left.
    rough = np.roll(rough, -int(rough.sum(axis=1).argmin()), axis=0)
    points = outline.reshape(-1, 2).astype(np.float64)
    lines = [_side(points, rough[k], rough[(k + 1) % 4]) for k in range(4)]
    return np.array([_meeting(lines[k - 1], lines[k]) for k in range(4)])


def _side(points: Corners, start: Corners, end: Corners) -> NDArray[np.float64]:
    """Return the line through the points of an outline along a side, as a x + b y + c = 0."""
    along = (end - start) / np.hypot(*(end - start))
    normal = np.array([-along[1], along[0]])
    passed = (points - start) @ along / np.hypot(*(end - start))
    near = (np.abs((points - start) @ normal) < _LOOSE_PX) & (passed > 0.05) & (passed < 0.95)
    if near.sum() < 2:
        return np.array([*normal, -normal @ start])
    x, y, x0, y0 = cv2.fitLine(points[near].astype(np.float32), cv2.DIST_HUBER, 0, 0.01, 0.01)[:, 0]
    return np.array([-y, x, y * x0 - x * y0])


def _meeting(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, w = np.cross(first, second)
    return np.array([x / w, y / w]) if abs(w) > 1e-9 else np.full(2, np.nan)


def _is_sheet(corners: Corners, outline: NDArray[np.int32], paper: Grey) -> bool:
    """Return whether four corners are those of a sheet with a darker background."""
    if not np.isfinite(corners).all():
        return False
    area = cv2.contourArea(corners.astype(np.float32))
    if not _LEAST_FILLED < cv2.contourArea(outline) / max(area, 1.0) < 2 - _LEAST_FILLED:
        return False
    sides = np.roll(corners, -1, axis=0) - corners
    angle = np.degrees(np.arctan2(sides[:, 1], sides[:, 0]))
    turn = (np.roll(angle, -1) - angle) % 360
    if np.abs(turn - 90).max() > _MOST_ANGLE:
        return False
    height, width = paper.shape
    seen = 0
    for corner, side in zip(corners, sides, strict=True):
        along = corner + np.linspace(0.1, 0.9, 40)[:, None] * side
        outwards = np.array([side[1], -side[0]]) / np.hypot(*side) * _EDGE_PX
        outside = np.rint(along + outwards).astype(int)
        inside = np.rint(along - outwards).astype(int)
        within = (outside >= 0).all(axis=1) & (outside < (width, height)).all(axis=1)
        within &= (inside >= 0).all(axis=1) & (inside < (width, height)).all(axis=1)
        if within.mean() < 0.5:
            continue
        steps = paper[*inside[within].T[::-1]].astype(float) - paper[*outside[within].T[::-1]]
        if np.percentile(steps, 20) < _LEAST_STEP:
            return False
        seen += 1
    return seen >= _LEAST_SIDES
