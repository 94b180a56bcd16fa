"""Configuration of a run."""

import math
from collections.abc import Iterable
from typing import Any, ClassVar, Self

from pydantic import (
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.functional_validators import ModelWrapValidatorHandler

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, TableError, choice_of, require_within
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.profile import Profile
from smarttouch.profile.toml_tables import Table, table_error
from smarttouch.stimulation.impedance_control import Hold
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy, unsupported_reason

_CHOICES = {"mode": [*Mode], "scan": ["auto", "points"], "hold": ["charge", "energy"]}


class RunConfig(Table):
    """Settings of one run; None means the profile's value, or no limit.

    Parameters
    ----------
    mode : Mode or str
        Classes to stimulate: RA, SAI, PC or natural.
    scan : {"auto", "points"} or SlotPolicy
        points: each slot stimulates one point. auto: in RA, independent sites share slots if the
        board has a current source for each electrode.
    rate_hz : float, optional
        Pulses per second at each point, for modes with one class.
    seconds : float, optional
        Time limit of the run.
    intensity : float, in [0, 1], optional
        Intensity, relative to the strongest comfortable current. It is required on boards that a
        finger may touch; otherwise the default is 1.
    softness : float, in [0, 1], optional
        At 1 the SAI rate is constant, at 0 it follows force.
    light_on_dark : bool
        Whether print is lighter than paper.
    tone : Tone, optional
        Tone curve from ink to activation.
    line_cue : bool
        Whether the first or last row pulses if the line of print is above or below the array.
    hold : {"charge", "energy"}, optional
        Quantity of each pulse to keep constant while impedance drifts, if the board allows it.
    balance : bool
        Whether to keep the net charge of each electrode near zero.
    paced : bool
        Whether a run on a board with simulated time takes real time, so that a person can watch and
        control the run. On other boards a run always takes real time.
    seed : int
        Seed of the source; stored in recordings.
    subject, note : str
        Texts that are stored in recordings.

    Raises
    ------
    SmartTouchError
        If a value is impossible.

    Examples
    --------
    >>> import smarttouch as st
    >>> st.RunConfig(mode="SAI", seconds=2).mode
    <Mode.SAI: 'SAI'>
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(allow_inf_nan=True)

    mode: Mode | str = Mode.RA
    scan: str | SlotPolicy = "auto"
    rate_hz: float | None = None
    seconds: float | None = None
    intensity: float | None = None
    softness: float | None = None
    light_on_dark: bool = False
    tone: Tone | None = None
    line_cue: bool = False
    hold: Hold | None = None
    balance: bool = False
    paced: bool = False
    seed: int = Field(default=0, ge=0)
    subject: str = ""
    note: str = ""

    @field_validator("mode", "scan", "hold", mode="before")
    @classmethod
    def _chosen(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, str):
            return choice_of(str(info.field_name), value, _CHOICES[str(info.field_name)])
        return value

    @field_validator("intensity", "softness", "seconds")
    @classmethod
    def _possible(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is not None:
            endless = info.field_name == "seconds"
            largest = math.inf if endless else 1
            require_within(SmartTouchError, str(info.field_name), value, 0, largest, above=endless)
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _in_a_sentence(cls, settings: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(settings)
        except ValidationError as error:
            raise table_error(TableError, "settings of a run", error) from None

    @classmethod
    def read(cls, texts: Iterable[str]) -> dict[str, Any]:
        """Parse settings such as ``softness=0.5``; a name without a value means True."""
        settings = {}
        for text in texts:
            name, mark, value = text.partition("=")
            settings[choice_of("set", name, cls.model_fields)] = value if mark else "yes"
        config = cls(**settings)
        return {name: getattr(config, name) for name in settings}

    def sharing(self, profile: Profile) -> SlotPolicy:
        """Return the classes whose points share slots.

        With ``scan="auto"`` only RA shares slots. No class does if ``hold`` is set, if selectivity
        cannot be proved for the array (`provable`), or if board or profile exclude shared slots.
        """
        if unsupported_reason(profile) is not None or self.scan == "points":
            sharing = NO_SHARING
        elif isinstance(self.scan, SlotPolicy):
            sharing = self.scan
        else:
            from smarttouch.kernels.slot_selectivity import provable

            shares = not self.hold and provable(profile)
            sharing = SlotPolicy((Afferent.RA,)) if shares else NO_SHARING
        if self.hold is not None and sharing.afferents:
            raise SmartTouchError(
                "hold needs the voltage of each point, but with this scan several points share "
                "a slot: set scan=points"
            )
        return sharing


def configured(config: RunConfig | None, settings: dict[str, Any]) -> RunConfig:
    """Return a configuration with changed settings, by default based on ``RunConfig()``."""
    return (config or RunConfig()).model_copy(update=settings)
