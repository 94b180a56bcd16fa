"""Profiles: what calibration knows of one device on one finger, as TOML files."""

import tomllib
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from smarttouch import electrodes
from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import ProfileError
from smarttouch.resources import data_folder

DEFAULT_PROFILE = "electric-mouse"

CEILING_MA = 5.0
CEILING_PULSE_US = 200.0
CEILING_CHARGE_UC = 0.5
SHORTEST_RAMP_S = 0.5
"""The project's ceilings: a profile may ask for less, never for more."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Ratio = Annotated[float, Field(ge=0, le=1)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)


class GridLayout(_Table):
    """A rectangular grid of discs, or of rings where an inner diameter is given."""

    layout: Literal["grid"]
    rows: int = Field(ge=1, le=64)
    columns: int = Field(ge=1, le=64)
    pitch_x_mm: Positive
    pitch_y_mm: Positive
    diameter_mm: Positive
    inner_diameter_mm: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _ring(self) -> Self:
        if self.inner_diameter_mm >= self.diameter_mm:
            raise ValueError(
                f"inner_diameter_mm {self.inner_diameter_mm:g} must be below diameter_mm "
                f"{self.diameter_mm:g}"
            )
        return self

    def build(self) -> ElectrodeArray:
        return electrodes.grid(
            self.rows,
            self.columns,
            self.pitch_x_mm,
            self.pitch_y_mm,
            self.diameter_mm,
            self.inner_diameter_mm,
        )


class HexagonLayout(_Table):
    """The hexagon of 61 discs."""

    layout: Literal["hexagon-61"]
    pitch_mm: Positive
    diameter_mm: Positive

    def build(self) -> ElectrodeArray:
        return electrodes.hexagon(self.pitch_mm, self.diameter_mm)


class LineLayout(_Table):
    """Parallel line electrodes."""

    layout: Literal["lines"]
    count: int = Field(ge=2, le=64)
    pitch_mm: Positive
    width_mm: Positive
    length_mm: Positive

    def build(self) -> ElectrodeArray:
        return electrodes.lines(self.count, self.pitch_mm, self.width_mm, self.length_mm)


class FreeLayout(_Table):
    """Electrodes anywhere, one after the other."""

    layout: Literal["free"]
    positions_mm: tuple[tuple[float, float], ...] = Field(max_length=4096)
    shape: Literal["point", "disc", "annulus", "rectangle"] = "disc"
    size_mm: tuple[float, float] = (1.0, 0.0)
    """Diameter (and inner diameter) of a disc or annulus; width and height of a rectangle."""

    @model_validator(mode="after")
    def _sized(self) -> Self:
        first, second = self.size_mm
        inside = {
            "point": True,
            "disc": first > 0 and second == 0,
            "annulus": first > second > 0,
            "rectangle": first > 0 and second > 0,
        }
        if not inside[self.shape]:
            raise ValueError(
                f"size_mm {list(self.size_mm)} does not go with shape {self.shape!r}: "
                "give [diameter, 0] of a disc, [outer, inner] of an annulus, [width, height] of "
                "a rectangle"
            )
        return self

    def build(self) -> ElectrodeArray:
        return electrodes.free(self.positions_mm, self.shape, self.size_mm)


class SkinLayer(_Table):
    """One layer of skin; the last one goes on without end."""

    name: str = ""
    thickness_mm: float = Field(default=float("inf"), gt=0)
    conductivity_s_per_m: Positive


class Spread(_Table):
    """How far the true finger may be from the nominal one; robust kernels hold over it."""

    ra_depth_mm: float = Field(default=0.1, ge=0)
    sai_depth_mm: float = Field(default=0.1, ge=0)
    pc_depth_mm: float = Field(default=0.3, ge=0)
    angle_deg: float = Field(default=10.0, ge=0, le=45)
    """Of flat axons in the plane, and of rising ones from the vertical."""
    conductivity_factor: float = Field(default=1.5, ge=1, le=100)
    """Each layer's by itself, up and down."""


class Skin(_Table):
    """The conducting medium and the afferents in it (paper, Section II-D)."""

    medium: Literal["half-space", "infinite", "layered", "plane"]
    """``plane`` is the paper's homogeneous 2D medium, for line electrodes."""
    conductivity_s_per_m: Positive | None = None
    layers: tuple[SkinLayer, ...] = ()
    """From the surface down, for ``layered``."""
    ra_depth_mm: Positive
    sai_depth_mm: Positive
    pc_depth_mm: Positive
    sai_angles_deg: tuple[float, ...] = Field(min_length=1)
    """Directions of the horizontal afferents; the first is the target of SAI mode."""
    node_spacing_mm: Positive
    """Spacing of the points at which unwanted activation is bounded."""
    ra_ending: Literal["passive", "active"] = "passive"
    """Whether the ending of a rising axon can fire: it decides RA's polarity."""
    internode_mm: Positive = 0.079
    """Between the nodes of Ranvier of an axon near its ending, 79 µm (Nolano et al. 2003)."""
    spread: Spread = Spread()

    @property
    def conductivity(self) -> float:
        """Of homogeneous skin, S/m."""
        return self.conductivity_s_per_m or 1.0

    @model_validator(mode="after")
    def _conducting(self) -> Self:
        layered = self.medium == "layered"
        if layered != bool(self.layers) or layered != (self.conductivity_s_per_m is None):
            raise ValueError(
                "a layered medium takes its conductivities from skin.layers, any other one from "
                "skin.conductivity_s_per_m: give just that"
            )
        if layered and not np.isinf(self.layers[-1].thickness_mm):
            raise ValueError("the last of skin.layers goes on without end: leave out thickness_mm")
        if any(np.isinf(layer.thickness_mm) for layer in self.layers[:-1]):
            raise ValueError("each of skin.layers but the last needs its thickness_mm")
        for name in ("ra", "sai", "pc"):
            depth = getattr(self, f"{name}_depth_mm")
            if depth - getattr(self.spread, f"{name}_depth_mm") <= 0:
                raise ValueError(
                    f"spread.{name}_depth_mm reaches the surface from {name}_depth_mm {depth:g}: "
                    "no fiber lies outside the skin; lower it"
                )
        return self


class Output(_Table):
    """What the display board can do."""

    kind: Literal["weighted", "three-state", "one-against-all"]
    polarities: tuple[Literal["anodic", "cathodic"], ...] = Field(
        default=("anodic", "cathodic"), min_length=1
    )
    impedance_kohm: Positive | tuple[Positive, ...] = 1.0
    """Measured, of electrode and skin: how electrodes share one source's current."""


class Optics(_Table):
    """The sensor patch, and its registration to the electrodes."""

    sensor_columns: int = Field(ge=2, le=4096)
    sensor_rows: int = Field(ge=2, le=4096)
    field_width_mm: Positive
    field_height_mm: Positive
    magnification: Positive
    """Millimeters on the array for one millimeter on the page."""
    rotation_deg: float = Field(default=0.0, ge=-180, le=180)
    offset_x_mm: float = Field(default=0.0, allow_inf_nan=False)
    offset_y_mm: float = Field(default=0.0, allow_inf_nan=False)


class ForceLaw(_Table):
    """How finger force gates intensity (paper, Section IV-B)."""

    law: Literal["linear", "logarithmic"]
    contact_n: Positive
    full_n: Positive

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.full_n <= self.contact_n:
            raise ValueError(f"full_n {self.full_n} must exceed contact_n {self.contact_n}")
        return self


class Pulse(_Table):
    """One slot of the scan."""

    width_us: int = Field(ge=10, le=int(CEILING_PULSE_US))
    discharge_us: int = Field(ge=20, le=5000)
    rate_hz: float = Field(ge=1, le=200)


class Limits(_Table):
    """What no sequence may exceed; the project's ceilings bound them."""

    current_ma: float = Field(gt=0, le=CEILING_MA)
    total_ma: Positive | None = None
    """Of all cathodes together in one slot; none if not given."""
    electrode_ma: tuple[Positive, ...] | None = None
    """Of each electrode, where some must stay below ``current_ma``."""
    pulse_us: float = Field(gt=0, le=CEILING_PULSE_US)
    charge_uc: float = Field(gt=0, le=CEILING_CHARGE_UC)
    rate_hz: float = Field(gt=0, le=200)
    duty: float = Field(gt=0, le=0.8)
    ramp_s: float = Field(ge=SHORTEST_RAMP_S, le=10)


class Perception(_Table):
    """Current at which each electrode is first felt, and the strongest that is comfortable."""

    threshold_ma: Positive | tuple[Positive, ...]
    comfort_ratio: float = Field(gt=1, le=10)


class Profile(_Table):
    """One device on one finger."""

    name: str = ""
    title: str = Field(min_length=1)
    array: Annotated[
        GridLayout | HexagonLayout | LineLayout | FreeLayout, Field(discriminator="layout")
    ]
    skin: Skin
    output: Output
    optics: Optics
    force: ForceLaw
    pulse: Pulse
    limits: Limits
    perception: Perception

    @cached_property
    def electrodes(self) -> ElectrodeArray:
        return self.array.build()

    @cached_property
    def threshold_ma(self) -> NDArray[np.float32]:
        """Detection threshold of each electrode, (E,) mA (magnitude)."""
        return np.broadcast_to(
            np.asarray(self.perception.threshold_ma, np.float32), (len(self.electrodes),)
        ).copy()

    @cached_property
    def admittance(self) -> NDArray[np.float64]:
        """What share each electrode takes of a source, (E,), relative."""
        impedance = np.asarray(self.output.impedance_kohm, np.float64)
        return np.broadcast_to(1 / impedance, (len(self.electrodes),)).copy()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.electrodes)
        for key, values in (
            ("perception.threshold_ma", self.perception.threshold_ma),
            ("output.impedance_kohm", self.output.impedance_kohm),
        ):
            if isinstance(values, tuple) and len(values) != count:
                raise ValueError(
                    f"{key} lists {len(values)} electrodes, the array has {count}: "
                    f"give {count} numbers, or one for all"
                )
        if self.skin.medium == "plane" and self.array.layout != "lines":
            raise ValueError(
                f"skin.medium 'plane' does not go with array.layout {self.array.layout!r}: "
                "it is for 'lines'; 'half-space' is for all"
            )
        lowered = self.limits.electrode_ma
        if lowered is not None and len(lowered) != count:
            raise ValueError(
                f"limits.electrode_ma lists {len(lowered)} electrodes, the array has {count}: "
                f"give {count} numbers, or leave it out"
            )
        full_ma = self.threshold_ma * self.perception.comfort_ratio
        # Thresholds are single precision: a limit of just their product is kept.
        over = full_ma > np.multiply(np.inf if lowered is None else lowered, 1 + 1e-6)
        if lowered is not None and over.any():
            index = int(over.argmax())
            raise ValueError(
                f"threshold_ma × comfort_ratio is {full_ma[index]:.2f} mA at electrode {index}, "
                f"above its limits.electrode_ma {lowered[index]:g}: lower one of the two"
            )
        strongest = float(full_ma.max())
        if strongest > self.limits.current_ma:
            raise ValueError(
                f"threshold_ma × comfort_ratio reaches {strongest:.2f} mA, above "
                f"limits.current_ma {self.limits.current_ma}: lower one of the two"
            )
        total = self.limits.total_ma
        if total is not None and total < strongest:
            raise ValueError(
                f"limits.total_ma {total:g} is below the {strongest:.2f} mA that threshold_ma × "
                "comfort_ratio sends through one electrode: raise it, or lower one of the two"
            )
        if self.pulse.width_us > self.limits.pulse_us:
            raise ValueError(
                f"pulse.width_us {self.pulse.width_us} is above limits.pulse_us "
                f"{self.limits.pulse_us}"
            )
        charge = strongest * self.pulse.width_us / 1000
        if charge > self.limits.charge_uc:
            raise ValueError(
                f"the strongest pulse carries {charge:.3f} µC, above limits.charge_uc "
                f"{self.limits.charge_uc}: lower comfort_ratio or pulse.width_us"
            )
        return self


def profile_names() -> list[str]:
    """Return the names of the shipped profiles."""
    return sorted(path.stem for path in data_folder("calibration").glob("*.toml"))


def load_profile(name: str | Path) -> Profile:
    """Load a shipped profile by name, or any profile by its file.

    Raises
    ------
    ProfileError
        If there is none, or it says something unknown or impossible.
    """
    path = data_folder("calibration") / f"{name}.toml"
    if str(name) not in profile_names():
        path = Path(name)
        if not path.is_file():
            raise ProfileError(
                f"no profile {str(name)!r}: give a TOML file or one of {', '.join(profile_names())}"
            )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ProfileError(f"{path} is not a readable TOML file: {error}") from None
    try:
        return Profile.model_validate({**table, "name": path.stem})
    except ValidationError as error:
        raise ProfileError(_first_complaint(path, error)) from None


def _first_complaint(path: Path, error: ValidationError) -> str:
    first = error.errors()[0]
    layouts = ("grid", "hexagon-61", "lines", "free")
    key = ".".join(str(part) for part in first["loc"] if part not in layouts)
    if first["type"] == "extra_forbidden":
        return f"{path}: unknown key {key!r}: remove it or correct its spelling"
    if first["type"] == "missing":
        return f"{path}: key {key!r} is missing: add it (any shipped profile shows how)"
    message = first["msg"].removeprefix("Value error, ")
    if not key:
        return f"{path}: {message}"
    given = repr(first["input"])
    return f"{path}: {key} = {given[:60]}: {message}"
