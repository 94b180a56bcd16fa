"""Detection of Braille dots in pictures."""

import cv2
import numpy as np
from numpy.typing import NDArray

_SIDES_PX = (350, 700, 1400)
"""Lengths to which the longer side of a picture is scaled in turn, to find dots of any size."""
_FEWEST_DOTS = 20


def shows_dots(grey: NDArray[np.uint8]) -> bool:
    """Return whether a picture, (H, W), shows a page of Braille, embossed or printed.

    The sheet can be rotated. The result is False for print, halftones and dotted paper, but also
    for strongly blurred dots and for labels of a few cells.
    """
    longest, shortest = max(grey.shape), min(grey.shape)
    for side_px in _SIDES_PX:
        scale = side_px / longest
        if 32 / shortest < scale < 2:
            method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
            picture = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=method)
            if any(_has_cells(_dots(polarity)) for polarity in (picture, cv2.bitwise_not(picture))):
                return True
    return False


def _dots(picture: cv2.typing.MatLike) -> NDArray[np.float64]:
    """Return the centers of dark spots, (N, 2), if most of the spots are round and equally large.
    Otherwise, return an empty array."""
    soft = cv2.GaussianBlur(picture, (0, 0), 1).astype(np.float32)
    depth = cv2.blur(soft, (31, 31)) - soft
    dark = (depth > max(4, depth.std())).astype(np.uint8)
    _, _, boxes, middles = cv2.connectedComponentsWithStats(dark)
    width, height, area = boxes[1:, 2:].T
    ascending = np.sort(area)
    # Weight the median by area, so that it ignores specks of noise.
    typical = ascending[np.searchsorted(ascending.cumsum(), area.sum() / 2)] if len(area) else 0
    alike = (area > typical / 2) & (area < typical * 2)
    alike &= np.maximum(width, height) < 2.5 * np.minimum(width, height)
    fill = (area / (width * height))[alike]
    if alike.sum() < _FEWEST_DOTS or area[alike].sum() < 0.75 * area.sum() or fill.mean() < 0.64:
        return np.empty((0, 2))
    return np.asarray(middles[1:][alike])


def _has_cells(dots: NDArray[np.float64]) -> bool:
    """Return whether dots form cells: most have a neighbor, few have neighbors on both sides."""
    if not len(dots):
        return False
    points = dots.astype(np.float32)
    distance, neighbors = cv2.batchDistance(points, points, cv2.CV_32F, normType=cv2.NORM_L2, K=9)
    steps = (dots[neighbors[:, 1:]] - dots[:, None]) @ (1, 1j) / np.median(distance[:, 1])
    # The four directions of a grid, as complex numbers, have equal fourth powers.
    to_nearest = steps[:, 0] / abs(steps[:, 0])
    steps /= np.exp(1j * np.angle((to_nearest**4).mean()) / 4)
    right, below, left, above = ((abs(steps - 1j**k) < 0.25).any(axis=1) for k in range(4))
    in_pairs = min((left | right).mean(), (above | below).mean()) > 0.3
    in_row, in_column = sorted([(left & right).mean(), (above & below).mean()])
    near = (left | right | above | below).mean()
    return bool(near > 0.6 and in_pairs and in_row < 0.01 and in_column < 0.25)
