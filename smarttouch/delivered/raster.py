"""Values collected at the pixels of a picture."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


class Raster:
    """Sum of the values at each pixel, or the strongest; values outside are dropped."""

    def __init__(self, shape: tuple[int, int], strongest: bool = False) -> None:
        self.value, self.count = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._put = np.maximum.at if strongest else np.add.at

    def add(self, row: NDArray[np.intp], column: NDArray[np.intp], values: Floats) -> None:
        """Add values at pixels, each (N,)."""
        rows, columns = self.value.shape
        on = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        self._put(self.value, (row[on], column[on]), values[on])
        np.add.at(self.count, (row[on], column[on]), 1)

    def mean(self, spread: Callable[[Floats], Floats]) -> Floats:
        """Return the mean at every pixel after spreading; 0 where there is none."""
        total, count = spread(self.value), spread(self.count)
        return np.divide(total, count, out=np.zeros_like(total), where=count > 1e-6)


def as_ink(values: Floats) -> NDArray[np.uint8]:
    """Return values in [0, 1] as grey levels; 255 is nothing, 0 the strongest."""
    return np.asarray(np.rint(255 * (1 - np.clip(values, 0, 1))), np.uint8)
