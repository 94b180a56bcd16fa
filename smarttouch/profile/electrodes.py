"""Electrode arrays: positions and shapes of electrodes, from profiles and from tables."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import read_csv
from smarttouch.base.tactile_image import one_line
from smarttouch.profile.toml_tables import Number, Positive, Table, UnfitError, raise_all, validated

Shape = Literal["point", "disc", "annulus", "rectangle"]

COINCIDENT_MM = 1e-3  # distance below which two electrodes count as duplicates


@dataclass(frozen=True, eq=False)
class ElectrodeArray:
    """Electrodes on the skin.

    x points right along a line of text, y **downward** as in an image. The origin is the center of
    the array. Raises ProfileError for fewer than two electrodes and for electrodes that overlap. An
    electrode within the hole of a ring does not overlap the ring.
    """

    __repr__ = one_line

    position_mm: NDArray[np.float64]  # (E, 2) centers
    # Width and height of an electrode's cell: the area of the image that the electrode shows.
    cell_mm: tuple[float, float]
    pitch_mm: float  # distance to the nearest neighbor
    shape: Shape = "disc"
    # Annulus: outer and inner diameter; disc: diameter and 0; rectangle: width and height.
    size_mm: tuple[float, float] = (1.0, 0.0)
    # If electrodes differ, the shape and size of each. Electrode 0 has `shape` and `size_mm`.
    own: tuple[tuple[Shape, tuple[float, float]], ...] | None = None

    def __post_init__(self) -> None:
        if len(self) < 2:
            raise ProfileError(
                f"the array has {len(self) or 'no'} electrode{'' if len(self) else 's'}: give at "
                "least two, because current needs a return path",
                key="electrodes",
            )
        # Equal electrodes can overlap, as in `activating_function_error.py`, but must not coincide.
        self.refuse_overlaps(COINCIDENT_MM if self.own is None else None)

    def refuse_overlaps(self, least_mm: float | None = None) -> None:
        """Raise ProfileError if electrodes overlap. If ``least_mm`` is given, raise it only if
        two centers are closer than ``least_mm``."""
        apart = self.distance_mm + np.diag(np.full(len(self), np.inf))
        touching = self._overlap(apart) if least_mm is None else apart < least_mm
        if touching.any():
            first, second = divmod(int(touching.argmax()), len(self))
            away = apart[first, second]
            how = "coincide" if away < COINCIDENT_MM else f"overlap at a distance of {away:.3g} mm"
            raise ProfileError(
                f"electrodes {first} and {second} {how} (center to center): move one of them, or "
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
        """For each shape and size that occurs, the electrodes that have this shape and size."""
        sites: dict[tuple[Shape, tuple[float, float]], list[int]] = {}
        for site, kind in enumerate(self.own or ((self.shape, self.size_mm),) * len(self)):
            sites.setdefault(kind, []).append(site)
        return {kind: np.array(which, np.intp) for kind, which in sites.items()}

    @cached_property
    def area_mm2(self) -> NDArray[np.float64]:
        """Area of each electrode, (E,) mm²; a point counts as a disc of 1 mm."""
        areas = np.zeros(len(self))
        for (shape, (first, second)), which in self.kinds.items():
            if shape == "point":
                first, second = 1.0, 0.0
            is_rectangle = shape == "rectangle"
            areas[which] = first * second if is_rectangle else np.pi / 4 * (first**2 - second**2)
        return areas

    def _overlap(self, apart_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which pairs of electrodes overlap, (E, E). Two rectangles count as overlapping
        only if their centers coincide."""
        outer, hole = np.zeros(len(self)), np.zeros(len(self))
        for (shape, (first, second)), which in self.kinds.items():
            outer[which] = first / 2 if shape in ("disc", "annulus") else 0
            hole[which] = second / 2 if shape == "annulus" else 0
        inside = apart_mm + outer[:, None] <= hole
        touching = apart_mm < np.maximum(outer[:, None] + outer, COINCIDENT_MM)
        return np.asarray(touching & ~inside & ~inside.T)

    @cached_property
    def extent_mm(self) -> tuple[float, float]:
        """Width and height of the array, including cells, mm."""
        span = np.ptp(self.position_mm, axis=0)
        return float(span[0] + self.cell_mm[0]), float(span[1] + self.cell_mm[1])


class GridLayout(Table):
    """Rectangular grid of discs, or of rings if an inner diameter is given."""

    layout: Literal["grid"]
    """Electrodes in rows and columns, numbered row by row from the top left."""
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
    """Inner diameter of rings, below ``diameter_mm``; 0 for discs."""

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
        return f"{size}, pitch {self.pitch_x_mm:g} mm"

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
    """Hexagon of 61 discs."""

    layout: Literal["hexagon-61"]
    """Nine rows of 5 to 9 electrodes, numbered as on the board: from the top, each row from right
    to left."""
    pitch_mm: Positive
    """Distance between neighbors."""
    diameter_mm: Positive
    """Diameter of each electrode."""

    def build(self) -> ElectrodeArray:
        """Return the electrodes, numbered as on the board."""
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
    """Vertical lines side by side."""
    count: int = Field(ge=2, le=64)
    """Number of electrodes."""
    pitch_mm: Positive
    """Distance between the middles of neighboring lines."""
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
    """Position of each electrode, right and down; the origin is arbitrary."""
    shape: Literal["point", "disc", "annulus", "rectangle"] = "disc"
    """Shape of all electrodes."""
    size_mm: tuple[float, float] = (1.0, 0.0)
    """Size that all electrodes have: [diameter, 0] for a disc, [outer, inner diameter] for an
    annulus, [width, height] for a rectangle."""
    shapes: tuple[Literal["point", "disc", "annulus", "rectangle"], ...] | None = None
    """Shape of each electrode, unless all electrodes are equal; requires ``sizes_mm``. An annulus
    can surround another electrode (paper, Section III-C)."""
    sizes_mm: tuple[tuple[float, float], ...] | None = None
    """Size of each electrode, as in ``size_mm``; requires ``shapes``."""

    @model_validator(mode="after")
    def _sized(self) -> Self:
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        yield from _unsized(self.shape, self.size_mm, "size_mm")
        count = len(self.positions_mm)
        lists = {"shapes": self.shapes, "sizes_mm": self.sizes_mm}
        if self.shapes is None and self.sizes_mm is None:
            return
        for key, values in lists.items():
            if len(values or ()) != count:
                yield UnfitError(
                    f"array.{key} lists {len(values or ())} of {count} electrodes: give shapes and "
                    "sizes_mm of all electrodes, or leave both out",
                    key=f"array.{key}",
                )
        for shape, size in zip(self.shapes or (), self.sizes_mm or (), strict=False):
            yield from _unsized(shape, size, "sizes_mm")

    def build(self) -> ElectrodeArray:
        """Return the electrodes in the listed order, with the origin in the center of the array."""
        position = np.array(self.positions_mm, np.float64).reshape(-1, 2)
        if len(position):
            position -= (position.max(axis=0) + position.min(axis=0)) / 2
        apart = np.linalg.norm(position[:, None] - position[None], axis=2)
        own_shapes, shape, size_mm = None, self.shape, self.size_mm
        if self.shapes is not None and self.sizes_mm is not None:
            own_shapes = tuple(zip(self.shapes, self.sizes_mm, strict=True))
            # The distance between concentric rings is the difference of their mean radii.
            line = [
                sum(size) / 4 if shape_name == "annulus" else 0.0 for shape_name, size in own_shapes
            ]
            apart = np.maximum(apart, np.abs(np.subtract.outer(line, line)))
            shape, size_mm = own_shapes[0]
        np.fill_diagonal(apart, np.inf)
        # Take the median, so that one close pair of electrodes does not determine the pitch.
        pitch = float(np.median(apart.min(axis=1))) if len(position) > 1 else 1.0
        array = ElectrodeArray(position, (pitch, pitch), pitch, shape, size_mm, own_shapes)
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
            f"{key} {list(size_mm)} is not the size of shape {shape!r}: give [diameter, 0] for a "
            "disc, [outer, inner] for an annulus, [width, height] for a rectangle",
            key=f"array.{key}",
        )


ArrayLayout = Annotated[
    GridLayout | HexagonLayout | LineLayout | FreeLayout, Field(discriminator="layout")
]


USUAL_DIAMETER_MM = 1.0


def layout_of(table: Path | str | NDArray[np.floating[Any]]) -> FreeLayout:
    """Return a layout of discs from coordinates, (E, 2), or coordinates and diameters, (E, 3), mm.
    A CSV file has columns ``x_mm``, ``y_mm`` and optionally ``diameter_mm``."""
    if isinstance(table, Path | str):
        path = Path(table)
        columns = read_csv(path, ProfileError, ("x_mm", "y_mm"), ("diameter_mm",), rising=False)
        numbers = np.column_stack([*columns.values()])
    else:
        path, numbers = Path("the table"), np.asarray(table, np.float64)
    if numbers.ndim != 2 or numbers.shape[1] not in (2, 3) or not len(numbers):
        raise ProfileError(
            f"a table of shape {numbers.shape} does not list electrodes: give (E, 2), mm right and "
            "down, or (E, 3) with diameters",
            key="electrodes",
        )
    layout = {
        "layout": "free",
        "positions_mm": numbers[:, :2].tolist(),
        "size_mm": (USUAL_DIAMETER_MM, 0.0),
    }
    if numbers.shape[1] == 3:
        sizes = [(size, 0.0) for size in numbers[:, 2].tolist()]
        layout |= {"shapes": ["disc"] * len(numbers), "sizes_mm": sizes}
    checked = validated(FreeLayout, path, layout)
    checked.build()
    return checked


def grid_of(size: str, pitch_mm: float, diameter_mm: float = 1.0) -> GridLayout:
    """Return a grid of discs; ``size`` is rows and columns, as in ``5x5``."""
    match = re.fullmatch(r"(\d+)x(\d+)", size)
    if match is None:
        raise ProfileError(
            f"{size!r} is not a grid size: give rows and columns, for example 5x5", key="grid"
        )
    if not 0 < diameter_mm < pitch_mm:
        raise ProfileError(
            f"discs of {diameter_mm:g} mm do not fit a pitch of {pitch_mm:g} mm: give a diameter "
            "above 0 and below the pitch",
            key="diameter_mm",
        )
    pitches = {"pitch_x_mm": pitch_mm, "pitch_y_mm": pitch_mm, "diameter_mm": diameter_mm}
    layout = {"layout": "grid", "rows": match[1], "columns": match[2], **pitches}
    return validated(GridLayout, "the grid", layout)
