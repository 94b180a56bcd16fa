"""Pulses on one electrode at a time, while someone feels or watches."""

import time
from collections.abc import Callable, Iterator

from smarttouch.boards.board import Board
from smarttouch.boards.probe import one_each
from smarttouch.errors import SequenceLateError, SmartTouchError
from smarttouch.profile import Profile
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence

_STEP_S = 0.04
_TIMES = 4
"""Each sequence is repeated for longer than a step, so that pulses do not pause."""


def walk(
    board: Board,
    profile: Profile,
    current_ma: float,
    seconds: float | None,
    next_key: Callable[[], str],
    say: Callable[[str], object],
) -> int:
    """Let one electrode after the other pulse on an open board; return how many were tried.

    Parameters
    ----------
    board : Board
    profile : Profile
    current_ma : float, mA
        Rises to this from zero.
    seconds : float, s, or None
        On each electrode; until a key if not given.
    next_key : callable
        Returns the key that was pressed, empty if none was; never waits.
    say : callable
        Shows a line.

    Raises
    ------
    SmartTouchError
        If the current is out of reach, or the time is none.
    """
    if seconds is not None and not seconds > 0:
        message = f"{seconds:g} s for each electrode must be above 0"
        raise SmartTouchError(message, about="seconds", value=seconds, allowed=0)
    tried = 0
    for site in range(len(profile.electrodes)):
        if site in profile.output.masked:
            say(f"electrode {site}: masked")
            continue
        how = "any key: next, q: end" if seconds is None else f"{seconds:g} s"
        pulses = pulse(board, profile, site, current_ma)
        say(f"electrode {site}: up to {current_ma:g} mA ({how})")
        tried += 1
        for step, _ in enumerate(pulses):
            key = next_key()
            if key in ("q", "\x03", "\x04"):
                return tried
            # Steps that were sent, not time: a computer that stood still has tried nothing.
            if key or (seconds is not None and step * _STEP_S >= seconds):
                break
    return tried


def pulse(board: Board, profile: Profile, site: int, current_ma: float) -> Iterator[None]:
    """Return an endless row of steps that each send a piece of a train on one electrode.

    Current rises from zero and stays; a train that is not gone on with ends by itself.

    Raises
    ------
    SmartTouchError
        If the current is out of reach: before anything is sent.
    """
    _check(profile, current_ma)
    return _pulses(board, profile, site, current_ma)


def _check(profile: Profile, current_ma: float) -> None:
    full_ma = float(profile.full_ma.max())
    if not 0 < current_ma <= full_ma:
        raise SmartTouchError(
            f"{current_ma:g} mA must be above 0 and at most the {full_ma:g} mA that the "
            "profile calls the strongest comfortable",
            about="current_ma",
            value=current_ma,
            allowed=full_ma,
        )


def _pulses(board: Board, profile: Profile, site: int, current_ma: float) -> Iterator[None]:
    """Send sequences that rise from zero to a current and stay there, one a step."""
    limits = SafetyLimits.of(profile)
    top = current_ma / limits.full_ma
    now = due = board.clock.now_ns()
    start: int | None = None
    while True:
        # After a pause of the computer it begins at zero again.
        start = now if start is None else start
        part = min(1.0, (now - start) / 1e9 / (limits.ramp_s * top))
        try:
            board.send(_point(profile, limits, site, part * current_ma, now), _TIMES, due)
        except SequenceLateError:
            start = None
        yield
        time.sleep(_STEP_S)
        due, now = now + round(1e9 * _STEP_S), board.clock.now_ns()


def _point(
    profile: Profile, limits: SafetyLimits, site: int, current_ma: float, time_ns: int
) -> ScanSequence:
    pulse = profile.pulse
    return one_each(
        limits,
        round(1000 * current_ma),
        pulse.width_us,
        current_ma / limits.full_ma,
        time_ns,
        cathodic="anodic" not in profile.output.polarities,
        sites=[site],
        masked=profile.output.masked,
        discharge_us=pulse.discharge_us,
        period_us=round(1e6 / pulse.rate_hz),
    )
