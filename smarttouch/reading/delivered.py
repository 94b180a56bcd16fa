"""What was delivered along a line, put back together into an image of it."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.electrodes import ElectrodeArray

PIXELS_PER_PITCH = 4
"""Of the image put together."""
_BLUR_X = 0.4
_BLUR_Y = 0.55
"""Standard deviations with which values spread between the places where they were taken, in cells:
wide enough to fill what lies between two rows, and no wider. Found on printed lines."""


class LinePicture:
    """Averages the values of electrodes at the places they passed.

    Parameters
    ----------
    electrodes : ElectrodeArray
        The E electrodes.
    length_mm : float, mm
        Of the line.
    """

    def __init__(self, electrodes: ElectrodeArray, length_mm: float) -> None:
        self._pixel_mm = min(electrodes.cell_mm) / PIXELS_PER_PITCH
        height_mm = electrodes.extent_mm[1]
        shape = (
            math.ceil(height_mm / self._pixel_mm),
            max(1, math.ceil(length_mm / self._pixel_mm)),
        )
        self._cell = tuple(side / self._pixel_mm for side in electrodes.cell_mm)
        self._column = electrodes.position_mm[:, 0] / self._pixel_mm - 0.5
        self._row = np.rint(
            (electrodes.position_mm[:, 1] + height_mm / 2) / self._pixel_mm - 0.5
        ).astype(np.intp)
        self._sum = np.zeros(shape, np.float32)
        self._count = np.zeros(shape, np.float32)

    def add(self, x_mm: float, values: NDArray[np.float32]) -> None:
        """Add what the electrodes did with the middle of the array at ``x_mm``, (E,) in [0, 1]."""
        column = np.rint(self._column + x_mm / self._pixel_mm).astype(np.intp)
        on = (column >= 0) & (column < self._sum.shape[1])
        np.add.at(self._sum, (self._row[on], column[on]), values[on])
        np.add.at(self._count, (self._row[on], column[on]), 1)

    def values(self) -> NDArray[np.float32]:
        """Return the mean at every place, (H, W) in [0, 1]; spread between those that have one."""
        total, count = self._spread(self._sum), self._spread(self._count)
        return np.divide(total, count, out=np.zeros_like(total), where=count > 1e-6)

    def _spread(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        sigma_x, sigma_y = _BLUR_X * self._cell[0], _BLUR_Y * self._cell[1]
        spread = cv2.GaussianBlur(
            values, (0, 0), sigma_x, sigmaY=sigma_y, borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(spread, np.float32)

    def at(self, x_mm: NDArray[np.floating], y_mm: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the mean where electrodes stood, from the line's left end and the top, (N,)."""
        # Rounding may have put them a pixel aside.
        total, count = (
            cv2.boxFilter(each, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
            for each in (self._sum, self._count)
        )
        last = np.array(self._sum.shape) - 1
        row = np.minimum(np.floor(y_mm / self._pixel_mm).astype(np.intp), last[0])
        column = np.minimum(np.floor(x_mm / self._pixel_mm).astype(np.intp), last[1])
        return np.asarray(total[row, column] / np.maximum(count[row, column], 1), np.float32)

    def picture(self, height: int) -> NDArray[np.uint8]:
        """Return it as ink on paper, (height, W) uint8."""
        grey = np.asarray(np.rint(255 * (1 - self.values())), np.uint8)
        size = (max(1, round(grey.shape[1] * height / grey.shape[0])), height)
        method = cv2.INTER_CUBIC if height > grey.shape[0] else cv2.INTER_AREA
        return np.asarray(cv2.resize(grey, size, interpolation=method), np.uint8)
