"""Electrode arrays: places and shapes of the electrodes."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ProfileError
from smarttouch.base.one_line import one_line

Shape = Literal["point", "disc", "annulus", "rectangle"]

COINCIDENT_MM = 1e-3  # distance below which two electrodes count as one given twice


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
        self.refuse_overlaps(COINCIDENT_MM if self.own is None else None)

    def refuse_overlaps(self, least_mm: float | None = None) -> None:
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


def _area_mm2(shape: Shape, size_mm: tuple[float, float]) -> float:
    first, second = size_mm
    if shape == "rectangle":
        return first * second
    if shape == "point":
        first, second = 1.0, 0.0
    return float(np.pi / 4 * (first**2 - second**2))
