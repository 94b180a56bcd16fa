"""Reconstruction of images from the values of moving electrodes."""

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.profile.electrodes import ElectrodeArray

Floats = NDArray[np.float32]


class Raster:
    """Sum of the values at each pixel of an image, or the largest value if ``strongest``."""

    def __init__(self, shape: tuple[int, int], strongest: bool = False) -> None:
        self.value: Floats = np.zeros(shape, np.float32)
        self.count: Floats = np.zeros(shape, np.float32)
        self._put = np.maximum.at if strongest else np.add.at

    def add(self, row: NDArray[np.intp], column: NDArray[np.intp], values: Floats) -> None:
        """Add N values at the pixels (row, column); ignore pixels outside of the image."""
        rows, columns = self.value.shape
        on = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        self._put(self.value, (row[on], column[on]), values[on])
        np.add.at(self.count, (row[on], column[on]), 1)

    def mean(self, spread: Callable[[Floats], Floats]) -> Floats:
        """Return the mean at each pixel. ``spread`` blurs the sums and the numbers of values before
        the division. Pixels that no value reaches, even by the blur, are 0."""
        total, count = spread(self.value), spread(self.count)
        return np.divide(total, count, out=np.zeros_like(total), where=count > 1e-6)


def as_ink(values: Floats) -> NDArray[np.uint8]:
    """Convert values in [0, 1] to gray levels: 0 becomes white (255), 1 becomes black (0)."""
    return np.asarray(np.rint(255 * (1 - np.clip(values, 0, 1))), np.uint8)


PIXELS_PER_PITCH = 4
_BLUR_X, _BLUR_Y = 0.4, 0.55
"""Standard deviations of the blur, in cells. In tests with printed lines, smaller values left gaps
between rows of electrodes."""


class LinePicture:
    """Picture of a line of print: the mean of the values that electrodes had at each place."""

    def __init__(self, electrodes: ElectrodeArray, length_mm: float) -> None:
        self._pixel_mm = min(electrodes.cell_mm) / PIXELS_PER_PITCH
        height_mm = electrodes.extent_mm[1]
        wide, high = (side / self._pixel_mm for side in electrodes.cell_mm)
        self._sigma = (_BLUR_X * wide, _BLUR_Y * high)
        self._column = electrodes.position_mm[:, 0] / self._pixel_mm - 0.5
        self._row = np.rint(
            (electrodes.position_mm[:, 1] + height_mm / 2) / self._pixel_mm - 0.5
        ).astype(np.intp)
        height, width = (math.ceil(side / self._pixel_mm) for side in (height_mm, length_mm))
        self._raster = Raster((height, max(1, width)))

    def add(self, x_mm: float, values: NDArray[np.float32]) -> None:
        """Add the activation, (E,) in [0, 1], with the array's middle at ``x_mm``."""
        column = np.rint(self._column + x_mm / self._pixel_mm).astype(np.intp)
        self._raster.add(self._row, column, values)

    def values(self) -> NDArray[np.float32]:
        """Return the mean at each pixel, (H, W) in [0, 1]. A blur fills gaps between electrodes."""
        x, y = self._sigma
        edge = cv2.BORDER_CONSTANT
        return self._raster.mean(
            lambda plane: np.asarray(cv2.GaussianBlur(plane, (0, 0), x, sigmaY=y, borderType=edge))
        )

    def picture(self, height: int) -> NDArray[np.uint8]:
        """Return the line as gray levels, (height, W) uint8."""
        grey = as_ink(self.values())
        size = (max(1, round(grey.shape[1] * height / grey.shape[0])), height)
        method = cv2.INTER_CUBIC if height > grey.shape[0] else cv2.INTER_AREA
        return np.asarray(cv2.resize(grey, size, interpolation=method), np.uint8)
