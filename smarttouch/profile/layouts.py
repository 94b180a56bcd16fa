"""Electrode arrays in profiles."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from smarttouch.profile.electrodes import ElectrodeArray, Shape
from smarttouch.profile.toml_tables import Number, Positive, Table, UnfitError, raise_all


class GridLayout(Table):
    """A rectangular grid of discs, or of rings where an inner diameter is given."""

    layout: Literal["grid"]
    """Electrodes in rows and columns, counted row by row from the upper left."""
    rows: int = Field(ge=1, le=64)
    """Number of rows."""
    columns: int = Field(ge=1, le=64)
    """Number of columns."""
    pitch_x_mm: Positive
    """Distance from one column to the next."""
    pitch_y_mm: Positive
    """Distance from one row to the next."""
    diameter_mm: Positive
    """Diameter of each electrode."""
    inner_diameter_mm: float = Field(default=0.0, ge=0)
    """Inner diameter of rings; 0 for discs, and below ``diameter_mm``."""

    @model_validator(mode="after")
    def _ring(self) -> Self:
        if self.inner_diameter_mm >= self.diameter_mm:
            raise UnfitError(
                f"inner_diameter_mm {self.inner_diameter_mm:g} must be below diameter_mm "
                f"{self.diameter_mm:g}",
                key="array.inner_diameter_mm",
            )
        return self

    def __str__(self) -> str:
        size = f"{self.rows} x {self.columns} discs of {self.diameter_mm:g} mm"
        return f"{size} at {self.pitch_x_mm:g} mm"

    def build(self) -> ElectrodeArray:
        """Return the electrodes, numbered row by row from the top left."""
        x = _centered(self.columns, self.pitch_x_mm)
        y = _centered(self.rows, self.pitch_y_mm)
        pitches = [self.pitch_x_mm] * (self.columns > 1) + [self.pitch_y_mm] * (self.rows > 1)
        return ElectrodeArray(
            position_mm=np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2),
            cell_mm=(self.pitch_x_mm, self.pitch_y_mm),
            pitch_mm=min(pitches or [self.pitch_x_mm]),
            shape="annulus" if self.inner_diameter_mm else "disc",
            size_mm=(self.diameter_mm, self.inner_diameter_mm),
        )


class HexagonLayout(Table):
    """The hexagon of 61 discs."""

    layout: Literal["hexagon-61"]
    """Electrodes in nine rows of 5 to 9, in the order of the board."""
    pitch_mm: Positive
    """Distance between neighbors."""
    diameter_mm: Positive
    """Diameter of each electrode."""

    def build(self) -> ElectrodeArray:
        """Return the electrodes as the board counts them, from the far row down with falling x:
        electrode 0 is at the right end of the top row."""
        height_mm = self.pitch_mm * np.sqrt(3) / 2
        points = [
            (x, -4 * height_mm + height_mm * row)
            for row, count in enumerate((5, 6, 7, 8, 9, 8, 7, 6, 5))
            for x in _centered(count, self.pitch_mm)[::-1]
        ]
        return ElectrodeArray(
            position_mm=np.array(points),
            cell_mm=(self.pitch_mm, float(height_mm)),
            pitch_mm=self.pitch_mm,
            size_mm=(self.diameter_mm, 0.0),
        )


class LineLayout(Table):
    """Parallel line electrodes."""

    layout: Literal["lines"]
    """Lines side by side, each running from top to bottom."""
    count: int = Field(ge=2, le=64)
    """Number of electrodes."""
    pitch_mm: Positive
    """Distance from the middle of one line to that of the next."""
    width_mm: Positive
    """Width of each line."""
    length_mm: Positive
    """Length of each line."""

    def build(self) -> ElectrodeArray:
        """Return the electrodes from left to right (the paper's Fig. 7 and 12)."""
        x = _centered(self.count, self.pitch_mm)
        return ElectrodeArray(
            position_mm=np.column_stack([x, np.zeros(self.count)]),
            cell_mm=(self.pitch_mm, self.length_mm),
            pitch_mm=self.pitch_mm,
            shape="rectangle",
            size_mm=(self.width_mm, self.length_mm),
        )


class FreeLayout(Table):
    """Electrodes at any positions."""

    layout: Literal["free"]
    """Electrodes at the listed positions."""
    positions_mm: tuple[tuple[Number, Number], ...] = Field(max_length=4096)
    """Position of each electrode, right and down; only differences count."""
    shape: Literal["point", "disc", "annulus", "rectangle"] = "disc"
    """Shape of all electrodes."""
    size_mm: tuple[float, float] = (1.0, 0.0)
    """Diameter (and inner diameter) of a disc or annulus; width and height of a rectangle."""
    shapes: tuple[Literal["point", "disc", "annulus", "rectangle"], ...] | None = None
    """Shape of each electrode, where they differ; given with ``sizes_mm``. A ring may stand around
    another electrode (paper, Section III-C)."""
    sizes_mm: tuple[tuple[float, float], ...] | None = None
    """Size of each electrode, where they differ, as in ``size_mm``; given with ``shapes``."""

    @model_validator(mode="after")
    def _sized(self) -> Self:
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        yield from _unsized(self.shape, self.size_mm, "size_mm")
        count = len(self.positions_mm)
        given = {"shapes": self.shapes, "sizes_mm": self.sizes_mm}
        if self.shapes is None and self.sizes_mm is None:
            return
        for key, values in given.items():
            if len(values or ()) != count:
                yield UnfitError(
                    f"array.{key} lists {len(values or ())} of {count} electrodes: give one for "
                    "each, of both shapes and sizes_mm, or neither",
                    key=f"array.{key}",
                )
        for shape, size in zip(self.shapes or (), self.sizes_mm or (), strict=False):
            yield from _unsized(shape, size, "sizes_mm")

    def build(self) -> ElectrodeArray:
        """Return the electrodes as listed; the origin moves to their middle."""
        position = np.array(self.positions_mm, np.float64).reshape(-1, 2)
        if len(position):
            position -= (position.max(axis=0) + position.min(axis=0)) / 2
        apart = np.linalg.norm(position[:, None] - position[None], axis=2)
        own, shape, size_mm = None, self.shape, self.size_mm
        if self.shapes is not None and self.sizes_mm is not None:
            own = tuple(zip(self.shapes, self.sizes_mm, strict=True))
            # A ring is as far away as its middle line.
            line = [sum(size) / 4 if each == "annulus" else 0.0 for each, size in own]
            apart = np.maximum(apart, np.abs(np.subtract.outer(line, line)))
            shape, size_mm = own[0]
        np.fill_diagonal(apart, np.inf)
        # Most electrodes' distance to their neighbor: one close pair must not set it for all.
        pitch = float(np.median(apart.min(axis=1))) if len(position) > 1 else 1.0
        array = ElectrodeArray(position, (pitch, pitch), pitch, shape, size_mm, own)
        array.refuse_overlaps()
        return array


def _centered(count: int, pitch_mm: float) -> NDArray[np.float64]:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pitch_mm, np.float64)


def _unsized(shape: Shape, size_mm: tuple[float, float], key: str) -> Iterator[UnfitError]:
    first, second = size_mm
    fits = {
        "point": True,
        "disc": first > 0 and second == 0,
        "annulus": first > second > 0,
        "rectangle": first > 0 and second > 0,
    }
    if not fits[shape]:
        yield UnfitError(
            f"{key} {list(size_mm)} does not go with shape {shape!r}: give [diameter, 0] of a "
            "disc, [outer, inner] of an annulus, [width, height] of a rectangle",
            key=f"array.{key}",
        )


ArrayLayout = Annotated[
    GridLayout | HexagonLayout | LineLayout | FreeLayout, Field(discriminator="layout")
]
