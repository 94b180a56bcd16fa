"""Electrode arrays in profiles."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from smarttouch.base import electrodes
from smarttouch.base.electrodes import ElectrodeArray, Shape
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
        return electrodes.grid(
            self.rows,
            self.columns,
            self.pitch_x_mm,
            self.pitch_y_mm,
            self.diameter_mm,
            self.inner_diameter_mm,
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
        return electrodes.hexagon(self.pitch_mm, self.diameter_mm)


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
        return electrodes.lines(self.count, self.pitch_mm, self.width_mm, self.length_mm)


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
        own = None
        if self.shapes is not None and self.sizes_mm is not None:
            own = tuple(zip(self.shapes, self.sizes_mm, strict=True))
        return electrodes.free(self.positions_mm, self.shape, self.size_mm, own)


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
