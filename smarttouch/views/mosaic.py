"""Mosaic of a page from the source's frames while it moved."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.page_image import Page
from smarttouch.profile import Optics
from smarttouch.sources.source_contract import Input

PIXEL_MM = 0.1
LARGEST_PIXELS = 40_000_000  # largest page; frames farther away are left out
_BLOCK = 256  # least growth of the canvas, in pixels


class Mosaic:
    """Average of frames at their poses; grows as the source moves."""

    def __init__(self, optics: Optics) -> None:
        self._optics = optics
        self._sum = np.zeros((0, 0), np.float32)
        self._count = np.zeros((0, 0), np.float32)
        self._first = self._end = np.zeros(2, np.intp)  # row and column, in pixels of a page
        self._number: int | None = None

    def add(self, given: Input) -> None:
        """Add an image, unless it is stale or was added before."""
        if given.number == self._number or given.stale or given.image is None:
            return
        self._number = given.number
        optics, pose = self._optics, given.pose
        # A warp samples points, so a frame finer than the page is averaged down first.
        wide, high = (
            round(each / PIXEL_MM) for each in (optics.field_width_mm, optics.field_height_mm)
        )
        image: NDArray[Any] = given.image
        if image.shape[1] > wide and image.shape[0] > high:
            image = cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA)
        height, width = image.shape
        turn = pose.angle_rad - math.radians(optics.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        half = math.hypot(optics.field_width_mm, optics.field_height_mm) / 2 / PIXEL_MM
        left, top = (math.floor(center / PIXEL_MM - half) for center in (pose.x_mm, pose.y_mm))
        side = 2 * math.ceil(half) + 2
        if not self._reach(top, left, side):
            return
        # Pixels of the frame become pixels of a tile of the page.
        scale_x = optics.field_width_mm / width / PIXEL_MM
        scale_y = optics.field_height_mm / height / PIXEL_MM
        turned = np.array([[cos * scale_x, -sin * scale_y], [sin * scale_x, cos * scale_y]])
        middle = np.array([pose.x_mm / PIXEL_MM - left, pose.y_mm / PIXEL_MM - top]) - 0.5
        shift = middle - turned @ [(width - 1) / 2, (height - 1) / 2]
        to_tile = np.column_stack([turned, shift])
        size = (side, side)
        tile = cv2.warpAffine(image, to_tile, size, borderMode=cv2.BORDER_REPLICATE)
        seen = cv2.warpAffine(np.ones_like(image), to_tile, size, flags=cv2.INTER_NEAREST)
        row, column = np.array([top, left]) - self._first
        place = (slice(row, row + side), slice(column, column + side))
        self._sum[place] += tile * seen
        self._count[place] += seen

    def _reach(self, top: int, left: int, side: int) -> bool:
        """Grow the canvas so that a tile lies on it; return whether it does."""
        start = np.array([top, left])
        if not self._sum.size:
            self._first = self._end = start
        first = np.where(start < self._first, np.minimum(start, self._first - _BLOCK), self._first)
        end = np.where(
            start + side > self._end, np.maximum(start + side, self._end + _BLOCK), self._end
        )
        if np.prod(end - first) > LARGEST_PIXELS:
            return False
        borders = np.column_stack([self._first - first, end - self._end])
        if borders.any():
            self._sum, self._count = (np.pad(each, borders) for each in (self._sum, self._count))
            self._first, self._end = first, end
        return True

    def page(self) -> tuple[Page, tuple[float, float]]:
        """Return the page and the place of its top left corner, (x, y) mm; raise if no frame was
        seen."""
        rows, columns = (np.flatnonzero(self._count.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            raise SmartTouchError(
                "the source gave no images of a page: there is nothing to draw", about="page"
            )
        area = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        count = self._count[area]
        paper = np.full_like(count, 226.0)
        grey: NDArray[np.float32] = np.divide(self._sum[area], count, out=paper, where=count > 0)
        top, left = (np.add(self._first, (rows[0], columns[0])) * PIXEL_MM).tolist()
        return Page(np.rint(grey).astype(np.uint8), PIXEL_MM), (left, top)
