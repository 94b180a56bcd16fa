"""Format of recordings: JSON schemas of topics, and the settings that sequences depend on.

Foxglove has no schema for a number by itself: its plots take any number of any
message, so `/finger`, `/sequence` and `/board` are ours. `/tactile_image` shows `/tactile` to those
who look; nothing is read from it.
"""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import RecordingError
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.running.config import RunConfig
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.scan_sequence import SlotPolicy

FORMAT = "1"  # version of the format, raised when older readers can no longer read it

METADATA = "smarttouch"

LAST = "/board"  # topic of a step's last message: with it a step is complete

INFO = 2

_NUMBER = {"type": "number"}
_PERHAPS = {"type": ["number", "null"]}
_INTEGER = {"type": "integer"}
_COUNTS = {"type": "array", "items": _INTEGER}
_ROW = {"type": "array", "items": _NUMBER, "description": "of each electrode; [] is all zero"}
_PROOF: dict[str, Any] = {"type": ["array", "null"], "items": _PERHAPS}
_NANOSECONDS = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_SECONDS = {"sec": {"type": "integer", "minimum": 0}, "nsec": _NANOSECONDS}
_TIME = {"type": "object", "title": "time", "properties": _SECONDS}
_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")


def _base64(description: str) -> dict[str, Any]:
    return {"type": "string", "contentEncoding": "base64", "description": description}


_IMAGE = {
    "timestamp": _TIME,
    "frame_id": {"type": "string"},
    "data": _base64("PNG"),
    "format": {"type": "string"},
}

SCHEMAS: dict[str, tuple[str, dict[str, Any]]] = {
    "/frame": ("foxglove.CompressedImage", _IMAGE),
    "/finger": (
        "smarttouch.Finger",
        {
            "time_ns": {**_INTEGER, "description": "since the start of the run"},
            "x_mm": _PERHAPS,
            "y_mm": _PERHAPS,
            "angle_rad": _PERHAPS,
            "force_n": {**_PERHAPS, "description": "that counted; null is unknown"},
            "number": {**_INTEGER, "description": "of the image at its source"},
            "age_ms": _NUMBER,
            "stale": {"type": "boolean"},
        },
    ),
    "/tactile": ("smarttouch.TactileImage", {"RA": _ROW, "SAI": _ROW, "PC": _ROW}),
    "/tactile_image": ("foxglove.CompressedImage", _IMAGE),
    "/request": (
        "smarttouch.PulseRequest",
        {
            "period_us": {
                "type": ["integer", "null"],
                "description": "until the source is asked again; null: by the profile's rates",
            },
            "level": {**_NUMBER, "description": "of the strongest, in [0, 1]"},
            "image": {"type": "boolean", "description": "whether there was one to see"},
            "imaged": {"type": "boolean", "description": "whether the tactile image is of it"},
        },
    ),
    "/sequence": (
        "smarttouch.ScanSequence",
        {
            "time_ns": _INTEGER,
            "frame": {**_INTEGER, "description": "number of the image"},
            "number": {"type": ["integer", "null"], "description": "the board's; null if lost"},
            "mode": {"type": "string"},
            "level": {**_NUMBER, "description": "what the user asked for, in [0, 1]"},
            "restarted": {"type": "boolean", "description": "intensity began at zero here"},
            "asked_us": {**_INTEGER, "description": "period that was wanted"},
            "period_us": _INTEGER,
            "intensity": _NUMBER,
            "strongest_ma": {**_NUMBER, "description": "of all electrodes and slots, magnitude"},
            "slots": _INTEGER,
            "electrodes": _INTEGER,
            "site": _COUNTS,
            "width_us": _COUNTS,
            "discharge_us": _COUNTS,
            "current_ua": _base64("int16 little endian (slots, electrodes), positive cathodic"),
            "vibration": {"type": ["array", "null"], "items": _NUMBER},
            "points": {**_PROOF, "description": "that share each slot; null if none do"},
            "worst_other": {**_PROOF, "description": "of each slot, of its weakest target"},
            "worst_spill": {**_PROOF, "description": "the same, of the own class elsewhere"},
            "recharge_us": {**_INTEGER, "description": "length of the recharge phase; 0 is none"},
            "recharge_ua": {
                **_base64("int16 little endian (electrodes,), positive cathodic; null is none"),
                "type": ["string", "null"],
            },
        },
    ),
    "/volts": (
        "smarttouch.Volts",
        {
            "time_ns": {**_INTEGER, "description": "of the sequence that was measured"},
            "number": {"type": ["integer", "null"], "description": "of that sequence"},
            "highest_v": _PERHAPS,
            "volts": _base64("float32 little endian (slots,)"),
        },
    ),
    "/board": (
        "smarttouch.Acknowledgment",
        {
            "sent": {"type": ["integer", "null"]},
            "acknowledged": _INTEGER,
            "refused": _INTEGER,
            "latency_us": _NUMBER,
            "work_us": _NUMBER,
            "clock_ns": {**_INTEGER, "description": "real time since the start; -1 if unknown"},
            "begun": {
                "type": ["integer", "null"],
                "description": "newest sequence that is known to have begun since the last step",
            },
            "first_pulse_us": {**_PERHAPS, "description": "from its image to its first pulse"},
            "waited_us": {**_PERHAPS, "description": "from its last byte to its first pulse"},
        },
    ),
    "/event": (
        "foxglove.Log",
        {
            "timestamp": _TIME,
            "level": {
                "title": "foxglove.LogLevel",
                "oneOf": [{"title": name, "const": at} for at, name in enumerate(_LEVELS)],
            },
            "message": {"type": "string"},
            "name": {"type": "string"},
            "file": {"type": "string"},
            "line": {"type": "integer", "minimum": 0},
        },
    ),
}
"""Name of each topic's schema, and the properties of its messages, all required."""


def schema(topic: str) -> dict[str, Any]:
    """Return the JSON schema of a topic's messages."""
    name, properties = SCHEMAS[topic]
    return {"title": name, "type": "object", "properties": properties, "required": list(properties)}


_Share = Annotated[float, Field(ge=0, le=1)]
_Positive = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]
_Microseconds = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
_Charge = Annotated[int, Field(ge=-(2**53), le=2**53)]
_Pulse = Annotated[int, Field(ge=0, le=65_535)]


class _Part(BaseModel):
    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid", frozen=True)


class _Timing(_Part):
    width_us: _Pulse | None = None
    discharge_us: _Pulse | None = None
    slot_extra_us: _Microseconds = 0.0
    scan_us: _Microseconds = 0.0
    every_electrode: bool = False
    in_index_order: bool = False
    own_widths: bool = True
    whole_hz: bool = False
    load: Annotated[float, Field(gt=0, le=1)] = 1.0


class _Tone(_Part):
    faintest: _Share
    fullest: _Share
    prepared: bool = False


class _Sharing(_Part):
    primaries: tuple[Literal["RA", "SAI", "PC"], ...] = ()
    planned: bool = True


class RecordedSettings(BaseModel):
    """Settings of a run that its sequences depend on: those of `Pipeline` and `Regulator`.

    Older recordings lack ``tone``, ``vibrated``, ``sharing`` or ``recharge``. ``carried_pc`` is the
    net charge of each electrode before a balanced run; empty if none.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="ignore", frozen=True)

    mode: Mode
    rate_hz: _Positive | None
    light_on_dark: bool
    softness: _Share | None
    hold: Literal["charge", "energy"] | None
    balance: bool
    recharge: bool = False
    carried_pc: tuple[_Charge, ...] = ()
    compliance_v: _Positive | None
    timed: _Timing = Field(alias="timing")
    toned: _Tone | None = Field(None, alias="tone")
    shared: _Sharing = Field(_Sharing(), alias="sharing")
    vibrated: bool = False
    in_sums: bool = False

    @property
    def timing(self) -> ScanTiming:
        """Scan timing fixed by the board."""
        return ScanTiming(**self.timed.model_dump())

    @property
    def config(self) -> RunConfig:
        """Configuration of a run with these settings, that neither holds nor balances."""
        return RunConfig(
            mode=self.mode,
            rate_hz=self.rate_hz,
            light_on_dark=self.light_on_dark,
            softness=self.softness,
            tone=None if self.toned is None else Tone(**self.toned.model_dump()),
            scan=SlotPolicy(tuple(Afferent[each] for each in self.shared.primaries)),
        )


def read_settings(table: dict[str, Any]) -> RecordedSettings:
    """Return the settings in a recording; RecordingError if one is missing or impossible."""
    try:
        settings = RecordedSettings.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise RecordingError(f"{key}: {first['msg']}") from None
    if settings.shared.planned and settings.shared.primaries:
        raise RecordingError("the recording is of scan=frame, which 1.0.0rc1 had: replay it there")
    return settings
