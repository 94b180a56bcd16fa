"""Settings of a recorded run that sequences depend on, validated when read."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import RecordingError
from smarttouch.imaging.mapping import Tone
from smarttouch.stimulation.sharing import SlotPolicy
from smarttouch.stimulation.timing import ScanTiming

_Share = Annotated[float, Field(ge=0, le=1)]
_Positive = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]
_Microseconds = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
_Charge = Annotated[int, Field(ge=-(2**53), le=2**53)]
_Pulse = Annotated[int, Field(ge=0, le=65_535)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


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


class RunSettings(BaseModel):
    """Settings of a run that its sequences depend on: those of `Pipeline` and `Regulator`.

    Older recordings lack ``tone``, ``vibrated``, ``sharing`` or ``recharge``. ``carried_pc`` is the
    net charge of each electrode before a balanced run; empty if none.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

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
    def tone(self) -> Tone | None:
        """Tone curve from ink to activation."""
        return None if self.toned is None else Tone(**self.toned.model_dump())

    @property
    def sharing(self) -> SlotPolicy:
        """Classes whose points shared slots."""
        return SlotPolicy(
            tuple(Afferent[each] for each in self.shared.primaries), self.shared.planned
        )


def read_settings(table: dict[str, Any]) -> RunSettings:
    """Return the settings in a recording; RecordingError if one is missing or impossible."""
    try:
        return RunSettings.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise RecordingError(f"{key}: {first['msg']}", about=f"settings.{key}") from None
