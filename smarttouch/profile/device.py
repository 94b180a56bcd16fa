"""A profile: one device on one finger."""

from datetime import datetime
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from smarttouch.electrodes import ElectrodeArray
from smarttouch.profile.array import ArrayLayout
from smarttouch.profile.ceilings import (
    CEILING_CHARGE_UC,
    CEILING_DENSITY_UC_CM2,
    CEILING_DUTY,
    CEILING_MA,
    CEILING_PULSE_US,
    CEILING_RATE_HZ,
    CEILING_SESSION_MC,
    CEILING_SESSION_S,
    CEILING_TOTAL_MA,
    LEAST_DISCHARGE_US,
    SHORTEST_RAMP_S,
)
from smarttouch.profile.skin import Skin
from smarttouch.profile.table import Number, Positive, Table


class Output(Table):
    """What the display board can do."""

    kind: Literal["weighted", "three-state", "one-against-all"]
    polarities: tuple[Literal["anodic", "cathodic"], ...] = Field(
        default=("anodic", "cathodic"), min_length=1
    )
    impedance_kohm: Positive | tuple[Positive, ...] = 1.0
    """Measured, of electrode and skin: how electrodes share one source's current."""
    masked: tuple[int, ...] = ()
    """Electrodes that are broken, open or shorted: never driven."""
    wiring: tuple[int, ...] | None = None
    """The board's output of each electrode; its own number if not given."""
    ua_per_count: Positive | None = None
    """Measured current of one count of the board's DAC, µA; the driver's nominal if not given."""

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        for key, values in (("masked", self.masked), ("wiring", self.wiring or ())):
            if len(set(values)) < len(values):
                twice = next(each for each in values if values.count(each) > 1)
                raise ValueError(f"output.{key} lists {twice} more than once: give each once")
            if min(values, default=0) < 0:
                raise ValueError(f"output.{key} lists {min(values)}: numbers begin at 0")
        return self


class Optics(Table):
    """The sensor patch, and its registration to the electrodes."""

    sensor_columns: int = Field(ge=2, le=4096)
    sensor_rows: int = Field(ge=2, le=4096)
    field_width_mm: Positive
    field_height_mm: Positive
    magnification: Positive
    """Millimeters on the array for one millimeter on the page."""
    rotation_deg: float = Field(default=0.0, ge=-180, le=180)
    offset_x_mm: Number = 0.0
    offset_y_mm: Number = 0.0
    homography: tuple[Number, ...] | None = Field(default=None, min_length=9, max_length=9)
    """Of a tilted camera, row by row: millimeters on the page around the middle of what the array
    covers become pixels of a frame of ``sensor_columns`` by ``sensor_rows`` (centers at whole
    numbers). Field, rotation and offset are not used where it is given."""
    flat_field: str | None = None
    """File with the dark level and the gain of every pixel, beside the profile."""


class ForceLaw(Table):
    """How finger force gates intensity (paper, Section IV-B)."""

    law: Literal["linear", "logarithmic"]
    contact_n: Positive
    full_n: Positive
    curve: tuple[float, ...] | None = Field(default=None, min_length=2, max_length=6)
    """From the reading of a load cell to newtons: coefficients of a polynomial, lowest first."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.full_n <= self.contact_n:
            raise ValueError(f"full_n {self.full_n} must exceed contact_n {self.contact_n}")
        return self


class Pulse(Table):
    """One slot of the scan."""

    width_us: int = Field(ge=10, le=int(CEILING_PULSE_US))
    discharge_us: int = Field(ge=LEAST_DISCHARGE_US, le=5000)
    rate_hz: float = Field(ge=1, le=CEILING_RATE_HZ)
    carrier: Literal["height", "width"] = "height"
    """What grows with intensity: the current, or how long it flows."""
    chronaxie_us: Positive = 200.0
    """Of the afferents: what the same current does in a shorter pulse."""
    ra_rate_hz: float = Field(default=30.0, ge=1, le=200)
    """Pulses of RA in natural mode; RA answers best at 30 Hz (paper, Fig. 2)."""
    sai_rate_hz: float = Field(default=50.0, ge=1, le=200)
    """Pulses of SAI in natural mode, at full force."""
    softness: float = Field(default=1.0, ge=0, le=1)
    """How little the rate of SAI pulses follows force: 1 soft, 0 hard (paper, Section III-B.2)."""


class Limits(Table):
    """What no sequence may exceed; the project's ceilings bound them."""

    current_ma: float = Field(gt=0, le=CEILING_MA)
    total_ma: float | None = Field(default=None, gt=0, le=CEILING_TOTAL_MA)
    """Of all cathodes together in one slot; the project's ceiling if not given."""
    electrode_ma: tuple[Positive, ...] | None = None
    """Of each electrode, where some must stay below ``current_ma``."""
    pulse_us: float = Field(gt=0, le=CEILING_PULSE_US)
    charge_uc: float = Field(gt=0, le=CEILING_CHARGE_UC)
    rate_hz: float = Field(gt=0, le=CEILING_RATE_HZ)
    duty: float = Field(gt=0, le=CEILING_DUTY)
    ramp_s: float = Field(ge=SHORTEST_RAMP_S, le=10)
    density_uc_cm2: float = Field(default=CEILING_DENSITY_UC_CM2, gt=0, le=CEILING_DENSITY_UC_CM2)
    """Charge of a pulse over the area of its electrode."""
    session_s: float = Field(default=CEILING_SESSION_S, gt=0, le=CEILING_SESSION_S)
    """Of scans with current, from opening the board to closing it."""
    session_mc: float = Field(default=CEILING_SESSION_MC, gt=0, le=CEILING_SESSION_MC)
    """Charge through any one electrode in that time."""


class Frames(Table):
    """What a slot of many points may do, where a whole frame is shown at once."""

    other: float = Field(default=0.3, gt=0, le=1)
    """To any other class, of the weakest target. 0.30 is the paper's own single SAI point on its
    line array (Fig. 8)."""
    spill: float = Field(default=0.3, gt=0, le=1)
    """To the own class more than a pitch from every target."""
    uneven: float = Field(default=0.05, gt=0, le=0.5)
    """How far targets may be from what was wished, of it."""
    share: bool | None = None
    """Whether points may share a slot; if not given, where ``limits.total_ma`` is."""


class Perception(Table):
    """Current at which each electrode is first felt, and the strongest that is comfortable."""

    threshold_ma: Positive | tuple[Positive, ...]
    comfort_ratio: float = Field(gt=1, le=10)
    comfort_ma: tuple[Positive, ...] | None = None
    """Measured strongest of each electrode; ``threshold_ma`` × ``comfort_ratio`` if not given."""
    ra_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    sai_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    pc_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """How far from the stimulated point a class is felt, right and down: at the receptor, not where
    its axon was hit (paper, Section III-B.4: PC 1 to 3 mm toward the fingertip)."""


class Calibrated(Table):
    """What a calibration found, when, and with what."""

    when: datetime
    versions: str
    found: str


class Profile(Table):
    """One device on one finger."""

    name: str = ""
    title: str = Field(min_length=1)
    array: ArrayLayout
    skin: Skin
    output: Output
    optics: Optics
    force: ForceLaw
    pulse: Pulse
    limits: Limits
    perception: Perception
    frames: Frames = Frames()
    calibrated: dict[str, Calibrated] = Field(default_factory=dict)

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
    def full_ma(self) -> NDArray[np.float32]:
        """Strongest comfortable current of each electrode, (E,) mA (magnitude)."""
        if self.perception.comfort_ma is not None:
            return np.asarray(self.perception.comfort_ma, np.float32)
        return self.threshold_ma * self.perception.comfort_ratio

    @property
    def shares(self) -> bool:
        """Whether points may share a slot, as far as the profile goes."""
        given = self.limits.total_ma is not None
        return given if self.frames.share is None else self.frames.share

    @property
    def design_total_ma(self) -> float | None:
        """Total current that kernels are designed within; None where none needs to be.

        A total at the project's ceiling, which holds for all, says nothing of the kernels
        where points do not share slots.
        """
        total = self.limits.total_ma or CEILING_TOTAL_MA
        return total if self.shares or total < CEILING_TOTAL_MA else None

    @cached_property
    def admittance(self) -> NDArray[np.float64]:
        """What share each electrode takes of a source, (E,), relative."""
        impedance = np.asarray(self.output.impedance_kohm, np.float64)
        return np.broadcast_to(1 / impedance, (len(self.electrodes),)).copy()

    @cached_property
    def driven(self) -> NDArray[np.intp]:
        """The electrodes that are not masked, in order."""
        return np.setdiff1d(np.arange(len(self.electrodes)), self.output.masked)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.electrodes)
        masked, wiring = self.output.masked, self.output.wiring
        if max(masked, default=0) >= count:
            raise ValueError(
                f"output.masked lists {max(masked)}, the array has electrodes 0 to {count - 1}: "
                "remove it"
            )
        if count - len(masked) < 2:
            raise ValueError(
                f"output.masked leaves {count - len(masked)} of {count} electrodes: current needs "
                "at least two, shorten the list or repair the array"
            )
        if wiring is not None and len(wiring) != count:
            raise ValueError(
                f"output.wiring lists {len(wiring)} electrodes, the array has {count}: "
                f"give {count} numbers, or leave it out"
            )
        for key, values in (
            ("perception.threshold_ma", self.perception.threshold_ma),
            ("perception.comfort_ma", self.perception.comfort_ma),
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
        full_ma = self.full_ma
        measured = self.perception.comfort_ma is not None
        strongest_of = "comfort_ma" if measured else "threshold_ma × comfort_ratio"
        painful = full_ma <= self.threshold_ma
        if painful.any():
            index = int(painful.argmax())
            raise ValueError(
                f"comfort_ma is {full_ma[index]:.2f} mA at electrode {index}, not above its "
                f"threshold_ma of {self.threshold_ma[index]:.2f}: measure both again"
            )
        # Thresholds are single precision: a limit of just their product is kept.
        over = full_ma > np.multiply(np.inf if lowered is None else lowered, 1 + 1e-6)
        if lowered is not None and over.any():
            index = int(over.argmax())
            raise ValueError(
                f"{strongest_of} is {full_ma[index]:.2f} mA at electrode {index}, "
                f"above its limits.electrode_ma {lowered[index]:g}: lower one of the two"
            )
        strongest = float(full_ma.max())
        if strongest > self.limits.current_ma:
            raise ValueError(
                f"{strongest_of} reaches {strongest:.2f} mA, above "
                f"limits.current_ma {self.limits.current_ma}: lower one of the two"
            )
        total = self.limits.total_ma
        if total is not None and total < strongest:
            raise ValueError(
                f"limits.total_ma {total:g} is below the {strongest:.2f} mA that {strongest_of} "
                "sends through one electrode: raise it, or lower one of the two"
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
                f"{self.limits.charge_uc}: lower {strongest_of} or pulse.width_us"
            )
        return self
