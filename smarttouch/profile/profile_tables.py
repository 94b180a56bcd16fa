"""Tables of a profile: device, limits, skin and kernels."""

from collections.abc import Iterator
from datetime import datetime
from typing import Literal, Self

from pydantic import Field, model_validator

from smarttouch.profile import project_ceilings
from smarttouch.profile.project_ceilings import CEILING_DENSITY_UC_CM2, CEILING_SESSION_MC
from smarttouch.profile.toml_tables import Number, Positive, Table, UnfitError, raise_all


class Output(Table):
    """Current outputs of the board."""

    kind: Literal["weighted", "three-state", "one-against-all"]
    """What the board can do. "weighted": set a separate current for each electrode. "three-state":
    make each electrode anode, cathode or off. "one-against-all": drive one electrode against all
    others."""
    polarities: tuple[Literal["anodic", "cathodic"], ...] = Field(
        default=("anodic", "cathodic"), min_length=1
    )
    """Polarities that the board can drive; positive currents are cathodic."""
    impedance_kohm: Positive | tuple[Positive, ...] = 1.0
    """Impedance of electrode and skin, one value for all electrodes or one for each. It determines
    how the current of a single source divides between electrodes."""
    masked: tuple[int, ...] = ()
    """Electrodes that are never driven, because they are broken, open or shorted."""
    wiring: tuple[int, ...] | None = None
    """For each electrode, the number of its board output; by default, the electrode's number."""
    ua_per_count: Positive | None = None
    """Measured current of one count of the board's DAC; by default the nominal current."""

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        for key, values in (("masked", self.masked), ("wiring", self.wiring or ())):
            if len(set(values)) < len(values):
                twice = next(value for value in values if values.count(value) > 1)
                yield UnfitError(
                    f"output.{key} lists {twice} more than once: list each number once",
                    key=f"output.{key}",
                )
            if min(values, default=0) < 0:
                yield UnfitError(
                    f"output.{key} lists the negative number {min(values)}: give 0 or more",
                    key=f"output.{key}",
                )


class Optics(Table):
    """The sensor, and its registration to the electrodes."""

    sensor_columns: int = Field(ge=2, le=4096)
    """Width of a frame in pixels."""
    sensor_rows: int = Field(ge=2, le=4096)
    """Height of a frame in pixels."""
    field_width_mm: Positive
    """Width of the area of the page that a frame shows."""
    field_height_mm: Positive
    """Height of the area of the page that a frame shows."""
    magnification: Positive
    """Millimeters on the array per millimeter on the page."""
    rotation_deg: float = Field(default=0.0, ge=-180, le=180)
    """Clockwise angle by which the array appears rotated in a frame."""
    offset_x_mm: Number = 0.0
    """How far the array's center is to the right of the frame's center, measured on the page."""
    offset_y_mm: Number = 0.0
    """How far the array's center is below the frame's center, measured on the page."""
    homography: tuple[Number, ...] | None = Field(default=None, min_length=9, max_length=9)
    """Homography of a tilted camera, row by row. It maps places on the page, mm from the center of
    the array, to pixels of a frame. Pixel centers have integer coordinates. A given homography
    replaces field, rotation and offset."""
    flat_field: str | None = None
    """File in the profile's folder that has the dark level and the gain of each pixel."""


class ForceLaw(Table):
    """Intensity as a function of finger force (paper, Section IV-B)."""

    law: Literal["linear", "logarithmic"]
    """How intensity rises between ``contact_n`` and ``full_n``."""
    contact_n: Positive
    """Force above which current flows."""
    full_n: Positive
    """Force above which intensity is full."""
    curve: tuple[float, ...] | None = Field(default=None, min_length=2, max_length=6)
    """Coefficients of the polynomial that converts readings of a load cell to newtons, beginning
    with the constant term."""
    source: str | None = Field(default=None, pattern=r"^[a-z0-9_]+:.")
    """Default source of force for real boards, for example ``hx711:/dev/ttyUSB1``. With
    ``fixed:0.9``, force is not measured but assumed to be 0.9 N."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.full_n <= self.contact_n:
            raise UnfitError(
                f"full_n {self.full_n} must exceed contact_n {self.contact_n}", key="force.full_n"
            )
        return self


class Pulse(Table):
    """Pulses and their rates."""

    width_us: int = Field(ge=10, le=int(project_ceilings.CEILING_PULSE_US))
    """Pulse width."""
    discharge_us: int = Field(ge=project_ceilings.LEAST_DISCHARGE_US, le=5000)
    """Time after each pulse in which electrodes are shorted, so that charge flows back."""
    rate_hz: float = Field(ge=1, le=project_ceilings.CEILING_RATE_HZ)
    """Sequences per second."""
    chronaxie_us: Positive = 200.0
    """Chronaxie of the afferents, which determines how much more current shorter pulses need."""
    ra_rate_hz: float = Field(default=30.0, ge=1, le=200)
    """RA pulses per second in natural mode; RA is most sensitive at 30 Hz (paper, Fig. 2)."""
    sai_rate_hz: float = Field(default=50.0, ge=1, le=200)
    """SAI pulses per second in natural mode, at full force."""
    softness: float = Field(default=1.0, ge=0, le=1)
    """Softness of the felt surface: at 0 (hard) the SAI rate follows force, at 1 (soft) it is
    constant (paper, Section III-B.2)."""


class Limits(Table):
    """Limits of every sequence, bounded by the project's ceilings."""

    current_ma: float = Field(gt=0, le=project_ceilings.CEILING_MA)
    """Largest current of any electrode."""
    total_ma: float | None = Field(default=None, gt=0, le=project_ceilings.CEILING_TOTAL_MA)
    """Largest total current of all cathodes in one slot; by default the project's ceiling.

    On a board with a single source, the total never exceeds the largest current of one electrode.
    """
    electrode_ma: tuple[Positive, ...] | None = None
    """Largest current of each electrode, if some must stay below ``current_ma``."""
    pulse_us: float = Field(gt=0, le=project_ceilings.CEILING_PULSE_US)
    """Longest pulse."""
    charge_uc: float = Field(gt=0, le=project_ceilings.CEILING_CHARGE_UC)
    """Largest charge of a pulse."""
    rate_hz: float = Field(gt=0, le=project_ceilings.CEILING_RATE_HZ)
    """Largest number of sequences per second."""
    duty: float = Field(gt=0, le=project_ceilings.CEILING_DUTY)
    """Largest share of time in which current flows."""
    ramp_s: float = Field(ge=project_ceilings.SHORTEST_RAMP_S, le=10)
    """Shortest time in which intensity rises from zero to full."""
    density_uc_cm2: float = Field(default=CEILING_DENSITY_UC_CM2, gt=0, le=CEILING_DENSITY_UC_CM2)
    """Largest charge of a pulse per area of the electrode."""
    session_s: float = Field(
        default=project_ceilings.CEILING_SESSION_S, gt=0, le=project_ceilings.CEILING_SESSION_S
    )
    """Longest total time of scans with current in a session (from opening to closing the board)."""
    session_mc: float = Field(default=CEILING_SESSION_MC, gt=0, le=CEILING_SESSION_MC)
    """Largest charge through one electrode in a session."""


class Frames(Table):
    """Slots that stimulate several points: whether they are allowed, and how exact they must be."""

    other: float = Field(default=0.3, gt=0, le=1)
    """Largest accepted off-target value: the largest activation of any other class, divided by the
    activation of the weakest target. The paper's SAI kernel for line electrodes reaches 0.30."""
    spill: float = Field(default=0.3, gt=0, le=1)
    """Largest accepted spill. Spill is the largest activation of the targets' class farther than
    one pitch from every target, divided by the activation of the weakest target."""
    uneven: float = Field(default=0.05, gt=0, le=0.5)
    """Largest relative deviation of a target from its requested activation."""
    share: bool | None = None
    """Whether a slot can have several points; by default only if ``limits.total_ma`` is given."""


class PerceptThresholds(Table):
    """Detection threshold and comfort level of each electrode, and perceived places."""

    threshold_ma: Positive | tuple[Positive, ...]
    """Detection threshold, one value for all electrodes or one for each."""
    comfort_ratio: float = Field(gt=1, le=10)
    """Comfort level as a multiple of the threshold."""
    comfort_ma: tuple[Positive, ...] | None = None
    """Measured comfort level of each electrode; by default ``threshold_ma`` × ``comfort_ratio``."""
    ra_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift [right, down] from the stimulated point to the place where RA is perceived."""
    sai_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift [right, down] from the stimulated point to the place where SAI is perceived."""
    pc_shift_mm: tuple[Number, Number] = (0.0, 0.0)
    """Shift [right, down] from the stimulated point to the place where PC is perceived. PC is
    perceived at the receptor, which is 1 to 3 mm closer to the fingertip than the stimulated axon
    (paper, Section III-B.4)."""


class CommandDefaults(Table):
    """Defaults of command-line options for this profile.

    The default source of force is `force.source`. Intensity has no default.
    """

    board: str | None = Field(default=None, pattern=r"^[a-z0-9_]+:")
    """URL of the board, for example ``kajimoto61:/dev/ttyUSB0``."""
    plain: bool = False
    """Whether runs print a line for each event instead of drawing."""
    read_as: Literal["shapes", "braille"] = "shapes"
    """Form in which text is read: letter shapes or Braille."""


class Calibrated(Table):
    """Result of a calibration, with its date and versions."""

    when: datetime
    """Date and time of the measurement."""
    versions: str
    """Versions of the software."""
    found: str
    """Result and its quality in one sentence."""


class Skin(Table):
    """Model of the skin and its afferents (paper, Section II-D)."""

    medium: Literal["half-space", "infinite", "plane"]
    """Geometry of the conductor; ``plane`` is the paper's homogeneous 2D medium, for line
    electrodes."""
    conductivity_s_per_m: Positive
    """Conductivity of the skin."""
    ra_depth_mm: Positive
    """Depth of the endings of RA axons, which rise toward the surface."""
    sai_depth_mm: Positive
    """Depth of the axons of SAI, which are horizontal."""
    pc_depth_mm: Positive
    """Depth of the axons of PC."""
    sai_angles_deg: tuple[float, ...] = Field(min_length=1)
    """Directions of horizontal axons. SAI mode targets axons of the first direction."""
    node_spacing_mm: Positive
    """Distance between neighboring nodes. The design of kernels checks off-target and spill at
    these nodes. Arrays of up to 200 electrodes need 0.25 mm or less."""
    ra_ending: Literal["passive", "active"] = "passive"
    """Whether the ending of a rising axon can fire. This determines the polarity of RA mode."""
    internode_mm: Positive = 0.079
    """Distance between nodes of Ranvier near the ending of an axon (Nolano et al., 2003)."""


class Kernels(Table):
    """Design of kernels."""

    neighbors: int | None = Field(default=None, ge=9, le=1024)
    """Largest number of electrodes in a kernel, which then uses the electrodes nearest to the site.
    By default, there is no limit. With 64, the design of kernels takes only minutes even for
    thousands of electrodes."""
