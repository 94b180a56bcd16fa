"""Registration of sensor to electrodes: which pixels each electrode sees."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from smarttouch.electrodes import ElectrodeArray
from smarttouch.profile import Optics

PIXELS_PER_CELL = 8
"""Working pixels across one electrode's cell; finer frames are averaged down first."""
_SAMPLES = 6
"""Sub-pixel samples per axis when the overlap of cell and pixel is measured."""


class Registration:
    """Averages the ink under each electrode's own aperture.

    A cell of the array, divided by the magnification, is a rectangle on the
    page. Each electrode gets the area-weighted mean over that rectangle; a
    bare warp would sample single pixels and alias.

    Parameters
    ----------
    electrodes : ElectrodeArray
        The E electrodes.
    optics : Optics
        Field of view, magnification, rotation and offset.
    frame_shape : tuple of int
        Rows and columns of the frames that will come.

    Attributes
    ----------
    working_shape : tuple of int
        Rows and columns at which the frame is binarized: never finer than
        `PIXELS_PER_CELL` needs.
    """

    def __init__(
        self, electrodes: ElectrodeArray, optics: Optics, frame_shape: tuple[int, int]
    ) -> None:
        cell_mm = min(electrodes.cell_mm) / optics.magnification
        finest = cell_mm / PIXELS_PER_CELL
        rows, columns = frame_shape
        self.frame_shape = frame_shape
        self.working_shape = (
            _reduced_side(rows, math.ceil(optics.field_height_mm / finest)),
            _reduced_side(columns, math.ceil(optics.field_width_mm / finest)),
        )
        self._reduced = np.empty(self.working_shape, np.uint8)
        self._flat = np.empty(self.working_shape[0] * self.working_shape[1], np.float32)
        self._weights = _aperture_matrix(electrodes, optics, self.working_shape)

    def reduce(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Bring a frame to the working shape by area averaging.

        The result is overwritten by the next call.
        """
        if self.working_shape == self.frame_shape:
            return image
        size = self.working_shape[::-1]
        cv2.resize(image, size, dst=self._reduced, interpolation=cv2.INTER_AREA)
        return self._reduced

    def sample(self, ink: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the mean of ``ink`` (0 or 255) under each electrode, (E,) in [0, 1]."""
        self._flat[:] = ink.ravel()
        return np.asarray(self._weights @ self._flat, np.float32)


def _reduced_side(side: int, wanted: int) -> int:
    """Return ``side`` over the largest whole number that leaves ``wanted`` or more.

    OpenCV averages by whole factors several times faster than by broken ones.
    """
    factors = range(max(1, side // wanted), 0, -1)
    return side // next(factor for factor in factors if side % factor == 0)


def _aperture_matrix(
    electrodes: ElectrodeArray, optics: Optics, shape: tuple[int, int]
) -> csr_array[np.float32]:
    rows, columns = shape
    width_mm, height_mm = (side / optics.magnification for side in electrodes.cell_mm)
    pixel_x = optics.field_width_mm / columns
    pixel_y = optics.field_height_mm / rows
    across = max(2, math.ceil(width_mm / pixel_x * _SAMPLES))
    down = max(2, math.ceil(height_mm / pixel_y * _SAMPLES))
    dx, dy = np.meshgrid(
        ((np.arange(across) + 0.5) / across - 0.5) * width_mm,
        ((np.arange(down) + 0.5) / down - 0.5) * height_mm,
    )
    turn = math.radians(optics.rotation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    center = electrodes.position_mm / optics.magnification
    x = center[:, 0, None] + dx.ravel()
    y = center[:, 1, None] + dy.ravel()
    column = np.floor((x * cos - y * sin + optics.offset_x_mm) / pixel_x + columns / 2)
    row = np.floor((x * sin + y * cos + optics.offset_y_mm) / pixel_y + rows / 2)
    # What lies outside the field of view is not seen: those samples count as paper.
    seen = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    electrode = np.broadcast_to(np.arange(len(electrodes))[:, None], seen.shape)
    pixel = (row * columns + column).astype(np.int64)
    share = np.full(int(seen.sum()), 1 / (255 * across * down), np.float32)
    entries = coo_array(
        (share, (electrode[seen], pixel[seen])), shape=(len(electrodes), rows * columns)
    )
    return entries.tocsr()
