"""Electrode arrays: places and shapes of the electrodes."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ProfileError, SmartTouchError
from smarttouch.base.one_line import one_line

Shape = Literal["point", "disc", "annulus", "rectangle"]

COINCIDENT_MM = 1e-3  # distance below which two electrodes count as one given twice

KAJIMOTO_61_ROWS = (5, 6, 7, 8, 9, 8, 7, 6, 5)


@dataclass(frozen=True, eq=False)
class ElectrodeArray:
    """Electrodes on the skin.

    x runs to the right along the text line, y **downward** as in an image; the origin is the
    array's center. Fewer than two electrodes, or two that overlap of which none is a ring around
    the other, raise a ProfileError.
    """

    __repr__ = one_line

    position_mm: NDArray[np.float64]  # (E, 2) center of each
    # Width and height of the patch of skin that one electrode stands for: its share of the array,
    # and the aperture through which it sees the page.
    cell_mm: tuple[float, float]
    pitch_mm: float  # distance to the nearest neighbor
    shape: Shape = "disc"
    # Outer and inner diameter of an annulus, diameter and 0 of a disc, width and height of a
    # rectangle.
    size_mm: tuple[float, float] = (1.0, 0.0)
    # Shape and size of each electrode, where they differ; `shape` and `size_mm` are then those of
    # the first.
    own: tuple[tuple[Shape, tuple[float, float]], ...] | None = None

    def __post_init__(self) -> None:
        if len(self) < 2:
            raise ProfileError(
                f"the array has {len(self) or 'no'} electrode{'' if len(self) else 's'}: give at "
                "least two, as current must go somewhere",
                key="electrodes",
            )
        # Of one shape they may overlap where a field is computed for each by itself.
        self._refuse_overlaps(COINCIDENT_MM if self.own is None else None)

    def _refuse_overlaps(self, least_mm: float | None = None) -> None:
        """Raise if two electrodes overlap, or are nearer to each other than a distance."""
        apart = self.distance_mm + np.diag(np.full(len(self), np.inf))
        touching = self._overlap(apart) if least_mm is None else apart < least_mm
        if touching.any():
            first, second = divmod(int(touching.argmax()), len(self))
            away = apart[first, second]
            how = "coincide" if away < COINCIDENT_MM else f"overlap {away:.3g} mm from each other"
            raise ProfileError(
                f"electrodes {first} and {second} {how}, middle to middle: move one of them, or "
                "make them smaller",
                key="electrodes",
                electrode=first,
            )

    def __len__(self) -> int:
        return len(self.position_mm)

    @cached_property
    def distance_mm(self) -> NDArray[np.float64]:
        """Center-to-center distances, (E, E) mm."""
        apart = self.position_mm[:, None, :] - self.position_mm[None, :, :]
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))

    @cached_property
    def kinds(self) -> dict[tuple[Shape, tuple[float, float]], NDArray[np.intp]]:
        """Electrodes of each shape and size, in order of the first of each."""
        every = self.own or ((self.shape, self.size_mm),) * len(self)
        return {
            kind: np.array([index for index, each in enumerate(every) if each == kind], np.intp)
            for kind in dict.fromkeys(every)
        }

    @cached_property
    def area_mm2(self) -> NDArray[np.float64]:
        """Area of each electrode, (E,) mm²; a point stands for a disc of 1 mm."""
        areas = np.zeros(len(self))
        for kind, which in self.kinds.items():
            areas[which] = _area_mm2(*kind)
        return areas

    def _overlap(self, apart_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which pairs lie on each other, (E, E); of rectangles, which coincide."""
        outer, hole = np.zeros(len(self)), np.zeros(len(self))
        for (shape, (first, second)), which in self.kinds.items():
            outer[which] = first / 2 if shape in ("disc", "annulus") else 0
            hole[which] = second / 2 if shape == "annulus" else 0
        inside = apart_mm + outer[:, None] <= hole
        touching = apart_mm < np.maximum(outer[:, None] + outer, COINCIDENT_MM)
        return np.asarray(touching & ~inside & ~inside.T)

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
    inner_diameter_mm: float = 0.0,
) -> ElectrodeArray:
    """Return a rectangular grid of discs or rings, numbered row by row from the top left."""
    x, y = np.meshgrid(_centered(columns, pitch_x_mm), _centered(rows, pitch_y_mm))
    return ElectrodeArray(
        position_mm=np.column_stack([x.ravel(), y.ravel()]),
        cell_mm=(pitch_x_mm, pitch_y_mm),
        pitch_mm=_nearest(columns, pitch_x_mm, rows, pitch_y_mm),
        shape="annulus" if inner_diameter_mm else "disc",
        size_mm=(diameter_mm, inner_diameter_mm),
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
        size_mm=(diameter_mm, 0.0),
    )


def lines(count: int, pitch_mm: float, width_mm: float, length_mm: float) -> ElectrodeArray:
    """Return parallel line electrodes, long in y (the paper's Fig. 7 and 12)."""
    x = _centered(count, pitch_mm)
    return ElectrodeArray(
        position_mm=np.column_stack([x, np.zeros(count)]),
        cell_mm=(pitch_mm, length_mm),
        pitch_mm=pitch_mm,
        shape="rectangle",
        size_mm=(width_mm, length_mm),
    )


def free(
    position_mm: Sequence[tuple[float, float]],
    shape: Shape,
    size_mm: tuple[float, float],
    own: tuple[tuple[Shape, tuple[float, float]], ...] | None = None,
) -> ElectrodeArray:
    """Return electrodes at any positions, numbered as given; the origin moves to their middle."""
    position = np.array(position_mm, np.float64).reshape(-1, 2)
    if len(position):
        position -= (position.max(axis=0) + position.min(axis=0)) / 2
    apart = np.linalg.norm(position[:, None] - position[None], axis=2)
    if own is not None:
        # A ring is as far away as its middle line.
        line = [sum(size) / 4 if each == "annulus" else 0.0 for each, size in own]
        apart = np.maximum(apart, np.abs(np.subtract.outer(line, line)))
        shape, size_mm = own[0]
    np.fill_diagonal(apart, np.inf)
    # Most electrodes' distance to their neighbor: one close pair must not set it for all.
    pitch = float(np.median(apart.min(axis=1))) if len(position) > 1 else 1.0
    array = ElectrodeArray(position, (pitch, pitch), pitch, shape, size_mm, own)
    array._refuse_overlaps()
    return array


def _area_mm2(shape: Shape, size_mm: tuple[float, float]) -> float:
    first, second = size_mm
    if shape == "rectangle":
        return first * second
    if shape == "point":
        first, second = 1.0, 0.0
    return float(np.pi / 4 * (first**2 - second**2))


def _nearest(columns: int, pitch_x_mm: float, rows: int, pitch_y_mm: float) -> float:
    pitches = [pitch for count, pitch in ((columns, pitch_x_mm), (rows, pitch_y_mm)) if count > 1]
    return min(pitches or [pitch_x_mm])


def _centered(count: int, pitch: float) -> NDArray[np.float64]:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pitch, np.float64)


def parse_ranges(
    text: str, about: str, error: type[SmartTouchError] = SmartTouchError
) -> list[tuple[int, int]]:
    """Return the first and last electrode of each range in a list such as ``0-7,12``."""
    found = [
        re.fullmatch("([0-9]{1,6})(?:-([0-9]{1,6}))?", part.strip()) for part in text.split(",")
    ]
    if None in found:
        message = f"{about} {text!r} are no list: give numbers and ranges like 0-7,12"
        raise error(message)
    return [(int(each[1]), int(each[2] or each[1])) for each in found if each]
