"""Electrode arrays: where the electrodes are and what they look like."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Shape = Literal["disc", "line"]

KAJIMOTO_61_ROWS = (5, 6, 7, 8, 9, 8, 7, 6, 5)
"""Electrodes per row of the hexagonal 61-electrode board."""


@dataclass(frozen=True, eq=False)
class ElectrodeArray:
    """Electrodes on the skin.

    Attributes
    ----------
    position_mm : ndarray, (E, 2) float64, mm
        Center of each electrode; x to the right along the text line, y
        **downward** along the page, as in an image. The origin is the array's
        center.
    cell_mm : tuple of float, mm
        Width and height of the patch of skin that one electrode stands for:
        its share of the array, and the aperture through which it sees the page.
    pitch_mm : float, mm
        Distance to the nearest neighbor.
    shape : {"disc", "line"}
        ``line`` electrodes are long in y, the paper's two-dimensional case.
    diameter_mm : float, mm
        Diameter of a disc, width of a line.
    """

    position_mm: NDArray[np.float64]
    cell_mm: tuple[float, float]
    pitch_mm: float
    shape: Shape = "disc"
    diameter_mm: float = 1.0

    def __len__(self) -> int:
        return len(self.position_mm)

    @cached_property
    def distance_mm(self) -> NDArray[np.float64]:
        """Center-to-center distances, (E, E) mm."""
        apart = self.position_mm[:, None, :] - self.position_mm[None, :, :]
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))

    @cached_property
    def extent_mm(self) -> tuple[float, float]:
        """Width and height of the array, cells included, mm."""
        span = np.ptp(self.position_mm, axis=0)
        return float(span[0] + self.cell_mm[0]), float(span[1] + self.cell_mm[1])


def grid(
    rows: int,
    columns: int,
    pitch_x_mm: float,
    pitch_y_mm: float,
    diameter_mm: float,
) -> ElectrodeArray:
    """Return a rectangular grid of discs, numbered row by row from the top left."""
    x, y = np.meshgrid(_centered(columns, pitch_x_mm), _centered(rows, pitch_y_mm))
    return ElectrodeArray(
        position_mm=np.column_stack([x.ravel(), y.ravel()]),
        cell_mm=(pitch_x_mm, pitch_y_mm),
        pitch_mm=min(pitch_x_mm, pitch_y_mm),
        diameter_mm=diameter_mm,
    )


def hexagon(pitch_mm: float, diameter_mm: float) -> ElectrodeArray:
    """Return the 61-electrode hexagon, in its board's own order.

    Rows of 5, 6, 7, 8, 9, 8, 7, 6, 5. The board counts from the far row down
    with falling x, so electrode 0 is at the right end of the top row and 60 at
    the left end of the bottom row.
    """
    height = pitch_mm * np.sqrt(3) / 2
    top = height * (len(KAJIMOTO_61_ROWS) - 1) / 2
    points = [
        (x, -top + height * row)
        for row, count in enumerate(KAJIMOTO_61_ROWS)
        for x in _centered(count, pitch_mm)[::-1]
    ]
    return ElectrodeArray(
        position_mm=np.array(points),
        cell_mm=(pitch_mm, float(height)),
        pitch_mm=pitch_mm,
        diameter_mm=diameter_mm,
    )


def lines(count: int, pitch_mm: float, width_mm: float, length_mm: float) -> ElectrodeArray:
    """Return parallel line electrodes, long in y (the paper's Fig. 7 and 12)."""
    x = _centered(count, pitch_mm)
    return ElectrodeArray(
        position_mm=np.column_stack([x, np.zeros(count)]),
        cell_mm=(pitch_mm, length_mm),
        pitch_mm=pitch_mm,
        shape="line",
        diameter_mm=width_mm,
    )


def _centered(count: int, pitch: float) -> NDArray[np.float64]:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pitch, np.float64)
