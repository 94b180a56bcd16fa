"""Format of recordings: their topics, and the settings that sequences depend on.

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

_SECONDS = {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}
_TIME = {"type": "object", "title": "time", "properties": _SECONDS}
_TEXT = {"type": "string"}
_PNG = {"type": "string", "contentEncoding": "base64", "description": "PNG"}
_IMAGE = {"timestamp": _TIME, "frame_id": _TEXT, "data": _PNG, "format": _TEXT}
_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
_LOG = {
    "timestamp": _TIME,
    "level": {
        "title": "foxglove.LogLevel",
        "oneOf": [{"title": name, "const": at} for at, name in enumerate(_LEVELS)],
    },
    "message": _TEXT,
    "name": _TEXT,
    "file": _TEXT,
    "line": {"type": "integer"},
}

TOPICS: dict[str, tuple[str, dict[str, Any]]] = {
    "/frame": ("foxglove.CompressedImage", _IMAGE),
    "/finger": ("smarttouch.Finger", {}),
    "/tactile": ("smarttouch.TactileImage", {}),
    "/tactile_image": ("foxglove.CompressedImage", _IMAGE),
    "/request": ("smarttouch.PulseRequest", {}),
    "/sequence": ("smarttouch.ScanSequence", {}),
    "/volts": ("smarttouch.Volts", {}),
    "/board": ("smarttouch.Acknowledgment", {}),
    "/event": ("foxglove.Log", _LOG),
}
"""Name of each topic's schema, and for those that Foxglove knows the properties of its messages."""


def schema(topic: str) -> dict[str, Any]:
    """Return the JSON schema of a topic's messages."""
    name, properties = TOPICS[topic]
    return {"title": name, "type": "object", "properties": properties, "required": [*properties]}


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
