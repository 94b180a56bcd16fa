"""Pictures of an array, pixel by pixel, for programs that show images."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from smarttouch.electrodes import ElectrodeArray
from smarttouch.physiology.felt import in_color

_PX_PER_CELL = 8
_RADIUS = 0.45
"""Of an electrode's disc, in cells."""


class ArrayImage:
    """Draws values of the electrodes as discs on white."""

    def __init__(self, electrodes: ElectrodeArray) -> None:
        cell = np.array(electrodes.cell_mm)
        pixel_mm = cell.min() / _PX_PER_CELL
        columns, rows = np.maximum(1, np.rint(np.array(electrodes.extent_mm) / pixel_mm)).astype(
            int
        )
        x = (np.arange(columns) - (columns - 1) / 2) * pixel_mm
        y = (np.arange(rows) - (rows - 1) / 2) * pixel_mm
        there = np.stack(np.meshgrid(x, y), axis=-1)
        away, nearest = cKDTree(electrodes.position_mm).query(there)
        self._nearest = np.asarray(nearest)
        self._on = away <= _RADIUS * min(cell.min(), electrodes.pitch_mm)

    def tactile(self, activation: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return a tactile image, (H, W, 3) in RGB: each class is an ink of its color."""
        inked = activation[:, self._nearest] * self._on
        return np.asarray(np.rint(255 * in_color(inked, 1.0)), np.uint8)
