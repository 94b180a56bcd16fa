"""The tables of a profile that tell what its device is and may do."""

from collections.abc import Iterator
from datetime import datetime
from typing import Literal, Self

from pydantic import Field, model_validator

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
from smarttouch.profile.table import Number, Positive, Table, UnfitError, raise_all


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
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        for key, values in (("masked", self.masked), ("wiring", self.wiring or ())):
            if len(set(values)) < len(values):
                twice = next(each for each in values if values.count(each) > 1)
                yield UnfitError(
                    f"output.{key} lists {twice} more than once: give each once",
                    about=f"output.{key}",
                    problem="twice",
                    value=twice,
                )
            if min(values, default=0) < 0:
                yield UnfitError(
                    f"output.{key} lists {min(values)}: numbers begin at 0",
                    about=f"output.{key}",
                    problem="too small",
                    value=min(values),
                    allowed=0,
                )


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
            raise UnfitError(
                f"full_n {self.full_n} must exceed contact_n {self.contact_n}",
                about="force.full_n",
                problem="too small",
                value=self.full_n,
                allowed=self.contact_n,
            )
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
