"""Tables of a profile: its device and limits, the skin, and the aim of its kernels."""

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
from smarttouch.profile.toml_tables import Number, Positive, Table, UnfitError, raise_all


class Output(Table):
    """Outputs of the display board."""

    kind: Literal["weighted", "three-state", "one-against-all"]
    """Whether each electrode has a current of its own, one of three states, or is driven alone
    against all others."""
    polarities: tuple[Literal["anodic", "cathodic"], ...] = Field(
        default=("anodic", "cathodic"), min_length=1
    )
    """Polarities that the board can drive; positive currents are cathodic."""
    impedance_kohm: Positive | tuple[Positive, ...] = 1.0
    """Impedance of electrode and skin, one for all or one for each; the current of one source
    divides among electrodes accordingly."""
    masked: tuple[int, ...] = ()
    """Electrodes that are broken, open or shorted, and are never driven."""
    wiring: tuple[int, ...] | None = None
    """The board's output of each electrode; its own number if not given."""
    ua_per_count: Positive | None = None
    """Measured current of one count of the board's DAC; the nominal current of the driver if not
    given."""

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        for key, values in (("masked", self.masked), ("wiring", self.wiring or ())):
            if len(set(values)) < len(values):
                twice = next(value for value in values if values.count(value) > 1)
                yield UnfitError(
                    f"output.{key} lists {twice} more than once: give each once",
                    key=f"output.{key}",
                )
            if min(values, default=0) < 0:
                yield UnfitError(
                    f"output.{key} lists {min(values)}: numbers begin at 0", key=f"output.{key}"
                )


class Optics(Table):
    """The sensor patch, and its registration to the electrodes."""

    sensor_columns: int = Field(ge=2, le=4096)
    """Width of a frame in pixels."""
    sensor_rows: int = Field(ge=2, le=4096)
    """Height of a frame in pixels."""
    field_width_mm: Positive
    """Width of the part of the page that a frame shows."""
    field_height_mm: Positive
    """Height of the part of the page that a frame shows."""
    magnification: Positive
    """Millimeters on the array per millimeter on the page."""
    rotation_deg: float = Field(default=0.0, ge=-180, le=180)
    """Angle of the array in a frame, clockwise."""
    offset_x_mm: Number = 0.0
    """Distance of the array's middle to the right of a frame's, on the page."""
    offset_y_mm: Number = 0.0
    """Distance of the array's middle below a frame's, on the page."""
    homography: tuple[Number, ...] | None = Field(default=None, min_length=9, max_length=9)
    """Homography of a tilted camera, by rows: millimeters on the page around the middle of what the
    array covers become pixels of a frame of ``sensor_columns`` by ``sensor_rows`` (centers at whole
    numbers). Field, rotation and offset are not used where it is given."""
    flat_field: str | None = None
    """File with the dark level and the gain of every pixel, beside the profile."""


class ForceLaw(Table):
    """Dependence of intensity on finger force (paper, Section IV-B)."""

    law: Literal["linear", "logarithmic"]
    """Shape of the rise of intensity between contact and full force."""
    contact_n: Positive
    """Force from which current flows."""
    full_n: Positive
    """Force from which intensity is full; above ``contact_n``."""
    curve: tuple[float, ...] | None = Field(default=None, min_length=2, max_length=6)
    """Coefficients of a polynomial, lowest first, from the reading of a load cell to newtons."""
    source: str | None = Field(default=None, pattern=r"^[a-z0-9_]+:.")
    """Source of force where a finger may be on the board and a run names none, for example
    ``hx711:/dev/ttyUSB1``, or ``fixed:0.9`` (N) where nothing measures it and a person presses."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.full_n <= self.contact_n:
            raise UnfitError(
                f"full_n {self.full_n} must exceed contact_n {self.contact_n}", key="force.full_n"
            )
        return self


class Pulse(Table):
    """Pulse of one slot of the scan."""

    width_us: int = Field(ge=10, le=int(CEILING_PULSE_US))
    """Time that current flows."""
    discharge_us: int = Field(ge=LEAST_DISCHARGE_US, le=5000)
    """Time after each pulse in which electrodes are shorted, and the charge of the skin flows
    back."""
    rate_hz: float = Field(ge=1, le=CEILING_RATE_HZ)
    """Sequences a second."""
    chronaxie_us: Positive = 200.0
    """Chronaxie of the afferents, which determines how much more current a shorter pulse needs."""
    ra_rate_hz: float = Field(default=30.0, ge=1, le=200)
    """Pulses of RA a second in natural mode; RA answers best at 30 Hz (paper, Fig. 2)."""
    sai_rate_hz: float = Field(default=50.0, ge=1, le=200)
    """Pulses of SAI a second in natural mode, at full force."""
    softness: float = Field(default=1.0, ge=0, le=1)
    """Softness: the rate of SAI pulses follows force at 0 (hard) and is constant at 1 (soft)
    (paper, Section III-B.2)."""


class Limits(Table):
    """Limits of every sequence, bounded by the project's ceilings."""

    current_ma: float = Field(gt=0, le=CEILING_MA)
    """Largest current of any electrode."""
    total_ma: float | None = Field(default=None, gt=0, le=CEILING_TOTAL_MA)
    """Largest current of all cathodes together in one slot; the project's ceiling if not given.

    With one source it is at most what a single electrode may carry.
    """
    electrode_ma: tuple[Positive, ...] | None = None
    """Largest current of each electrode, where some must stay below ``current_ma``."""
    pulse_us: float = Field(gt=0, le=CEILING_PULSE_US)
    """Longest pulse."""
    charge_uc: float = Field(gt=0, le=CEILING_CHARGE_UC)
    """Largest charge of a pulse."""
    rate_hz: float = Field(gt=0, le=CEILING_RATE_HZ)
    """Largest number of sequences a second."""
    duty: float = Field(gt=0, le=CEILING_DUTY)
    """Largest part of the time in which current flows."""
    ramp_s: float = Field(ge=SHORTEST_RAMP_S, le=10)
    """Shortest time in which intensity rises from zero to full."""
    density_uc_cm2: float = Field(default=CEILING_DENSITY_UC_CM2, gt=0, le=CEILING_DENSITY_UC_CM2)
    """Largest charge of a pulse over the area of its electrode."""
    session_s: float = Field(default=CEILING_SESSION_S, gt=0, le=CEILING_SESSION_S)
    """Longest time of scans with current, from opening the board to closing it."""
    session_mc: float = Field(default=CEILING_SESSION_MC, gt=0, le=CEILING_SESSION_MC)
    """Largest charge through any one electrode in that time."""


class Frames(Table):
    """Bounds of a slot with many points, where a whole frame is shown at once."""

    other: float = Field(default=0.3, gt=0, le=1)
    """Largest activation of any other class, relative to the weakest target. 0.30 is what a
    single SAI point reaches on the paper's line array, by the paper's own optimization."""
    spill: float = Field(default=0.3, gt=0, le=1)
    """Largest activation of the target's class more than a pitch from every target, relative to the
    weakest target."""
    uneven: float = Field(default=0.05, gt=0, le=0.5)
    """Largest deviation of a target from its intended activation, relative to it."""
    share: bool | None = None
    """Whether points may share a slot; if not given, they may where ``limits.total_ma`` is
    given."""


class PerceptThresholds(Table):
    """Detection threshold of each electrode, and its largest comfortable current."""

    threshold_ma: Positive | tuple[Positive, ...]
    """Current at which each electrode is first felt, one for all or one for each."""
    comfort_ratio: float = Field(gt=1, le=10)
    """Strongest comfortable current as a multiple of the threshold."""
    comfort_ma: tuple[Positive, ...] | None = None
    """Measured strongest comfortable current of each electrode; ``threshold_ma`` ×
    ``comfort_ratio`` if not given."""
    ra_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift of the place where RA is felt, right of and below the stimulated point."""
    sai_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift of the place where SAI is felt, right of and below the stimulated point."""
    pc_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift of the place where PC is felt, right of and below the stimulated point: at the
    receptor, not where its axon was hit (paper, Section III-B.4: PC 1 to 3 mm toward the
    fingertip)."""


class CommandDefaults(Table):
    """Values for options that are not given on the command line, with this profile.

    The source of force stands in `force.source`. Intensity is given with each run.
    """

    board: str | None = Field(default=None, pattern=r"^[a-z0-9_]+:")
    """URL of the board, for example ``kajimoto61:/dev/ttyUSB0``."""
    plain: bool = False
    """Whether runs print a line for each event and draw nothing."""
    read_as: Literal["shapes", "braille"] = "shapes"
    """Form of what is read: shapes or Braille."""


class Calibrated(Table):
    """Result of a calibration, with its date and versions."""

    when: datetime
    """When it was measured."""
    versions: str
    """Versions of the software that measured it."""
    found: str
    """Result and its quality in one sentence."""


class Skin(Table):
    """The conducting medium and the afferents in it (paper, Section II-D)."""

    medium: Literal["half-space", "infinite", "plane"]
    """Shape of the conductor; ``plane`` is the paper's homogeneous 2D medium, for line
    electrodes."""
    conductivity_s_per_m: Positive
    """Conductivity of the skin."""
    ra_depth_mm: Positive
    """Depth of the endings of RA, whose axons rise to the surface."""
    sai_depth_mm: Positive
    """Depth of the axons of SAI, which run flat."""
    pc_depth_mm: Positive
    """Depth of the axons of PC."""
    sai_angles_deg: tuple[float, ...] = Field(min_length=1)
    """Directions of the horizontal afferents; the first is the target of SAI mode."""
    node_spacing_mm: Positive
    """Spacing of the points at which unwanted activation is bounded: 0.1 in shipped profiles, at
    most 0.25 in a file of up to 200 electrodes; frames of many points take 0.5 at least."""
    ra_ending: Literal["passive", "active"] = "passive"
    """Whether the ending of a rising axon can fire, which determines RA's polarity."""
    internode_mm: Positive = 0.079
    """Distance between the nodes of Ranvier of an axon near its ending; 79 µm by Nolano et al.
    2003."""


class Kernels(Table):
    """Design of kernels."""

    neighbors: int | None = Field(default=None, ge=9, le=1024)
    """Number of electrodes around a site, at most, that its kernel drives; all if not given. About
    64 do on any array, and let one of thousands be designed in minutes."""
