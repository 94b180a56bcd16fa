"""Run configuration shared by all commands and by programs."""

import math
from dataclasses import asdict, dataclass
from typing import Any, TypedDict

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError, choice_of, require_within
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.profile import Profile
from smarttouch.stimulation.scan_sequence import NO_SHARING, SlotPolicy, unsupported_reason

SCANS = ("auto", "points")
HOLDS = ("charge", "energy")


class RunOptions(TypedDict, total=False):
    """Settings of `RunConfig` by keyword, but for the mode."""

    scan: str | SlotPolicy
    rate_hz: float | None
    seconds: float | None
    intensity: float | None
    softness: float | None
    light_on_dark: bool
    tone: Tone | None
    hold: str | None
    balance: bool
    paced: bool
    seed: int
    subject: str
    note: str


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Settings of one run; None takes the value of the profile.

    Parameters
    ----------
    mode : Mode or str
        Which afferents are driven: RA, SAI, PC or natural.
    scan : {"auto", "points"} or SlotPolicy
        points: one point in each slot; frame: as many as do not disturb one another; auto: the same
        where that needs no search (RA, on boards that give every electrode its own current).
    rate_hz : float, optional
        Sequences a second.
    seconds : float, optional
        Longest run by the clock.
    intensity : float, in [0, 1], optional
        Of the strongest comfortable current. On a board that a finger may be on it must be
        given, and is reached slowly; elsewhere it is 1 if not given.
    softness : float, in [0, 1], optional
        At 1 the rate of SAI pulses is constant, at 0 it follows force.
    light_on_dark : bool
        Print is lighter than paper.
    tone : Tone, optional
        How ink becomes activation.
    hold : {"charge", "energy"}, optional
        Held against drifting impedance, if the board can.
    balance : bool
        Keep net charge at zero.
    paced : bool
        On a board of simulated time, wait for the wall clock at each sequence, so that a person
        can watch, steer and answer. Boards with time of their own always wait.
    seed : int
        Of whatever is random in the source; kept in recordings.
    subject, note : str
        Kept in recordings.

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

    mode: Mode | str = Mode.RA
    scan: str | SlotPolicy = "auto"
    rate_hz: float | None = None
    seconds: float | None = None
    intensity: float | None = None
    softness: float | None = None
    light_on_dark: bool = False
    tone: Tone | None = None
    hold: str | None = None
    balance: bool = False
    paced: bool = False
    seed: int = 0
    subject: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        modes = tuple(each.value for each in Mode)
        object.__setattr__(self, "mode", Mode(choice_of("mode", str(self.mode), modes)))
        if not isinstance(self.scan, SlotPolicy):
            choice_of("scan", self.scan, SCANS)
        if self.hold is not None:
            choice_of("hold", self.hold, HOLDS)
        for name in ("intensity", "softness"):
            value = getattr(self, name)
            if value is not None:
                require_within(SmartTouchError, name, value, 0, 1)
        if self.seconds is not None:
            require_within(SmartTouchError, "seconds", self.seconds, 0, math.inf, above=True)

    def sharing(self, profile: Profile) -> SlotPolicy:
        """Return the classes whose points share slots.

        With scan auto RA alone, by kernels that are proved for all frames and only added up. None
        where voltage is held point by point, nothing can be proved, or the board cannot.
        """
        if unsupported_reason(profile) is not None or self.scan == "points":
            sharing = NO_SHARING
        elif isinstance(self.scan, SlotPolicy):
            sharing = self.scan
        else:
            from smarttouch.kernels.proved_sets import provable

            shares = not self.hold and provable(profile)
            sharing = SlotPolicy((Afferent.RA,)) if shares else NO_SHARING
        if self.hold is not None and sharing.afferents:
            raise SmartTouchError(
                "hold learns from the voltage of each point, and several share a slot: choose "
                "the scan points"
            )
        return sharing

    def settings(self, profile: Profile) -> dict[str, Any]:
        """Return what a recording keeps of it."""
        sharing, kept = self.sharing(profile), asdict(self)
        for name in ("scan", "seconds", "intensity", "paced"):
            del kept[name]
        primaries = [each.name for each in sharing.afferents]
        return kept | {
            "mode": str(self.mode),
            "sharing": {"primaries": primaries},
        }
