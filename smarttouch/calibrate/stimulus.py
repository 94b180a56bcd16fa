"""Current through one electrode, changed no faster than the ramp allows."""

import dataclasses
import math

from smarttouch.boards.board import Board
from smarttouch.boards.probe import one_each
from smarttouch.calibrate.limits import TICK_S
from smarttouch.profile import Profile
from smarttouch.stimulation.safety import SafetyLimits

_SPARE_TIMES = 3
"""Repetitions beyond a step, so that pulses do not pause between two steps."""


def measuring_limits(profile: Profile) -> SafetyLimits:
    """Return limits above the comfort of the profile, which is to be measured.

    Current, charge, pulse, rate, duty, sums and single electrodes stay limited
    as in the profile, and so does the rise in mA a second.
    """
    limits = SafetyLimits.of(profile)
    top_ma = max(limits.full_ma, _strongest_ma(profile))
    slower = limits.ramp_s * top_ma / limits.full_ma
    return dataclasses.replace(limits, full_ma=top_ma, ramp_s=slower)


def ceiling_ma(profile: Profile, site: int, board: Board) -> float:
    """Return the largest current of an electrode, mA: whole microamperes."""
    own = profile.limits.electrode_ma
    strongest = min(
        _strongest_ma(profile),
        math.inf if own is None else own[site],
        board.capabilities.max_current_ma,
    )
    return math.floor(1000 * strongest + 1e-6) / 1000


def slew_ma_s(profile: Profile) -> float:
    """Return the largest slope of current, mA/s."""
    limits = SafetyLimits.of(profile)
    return limits.full_ma / limits.ramp_s


def _strongest_ma(profile: Profile) -> float:
    limits = profile.limits
    by_charge = 1000 * limits.charge_uc / profile.pulse.width_us
    return min(limits.current_ma, by_charge, limits.total_ma or math.inf)


class Stimulus:
    """Pulses on one electrode of an open board, with all others as its return.

    Parameters
    ----------
    board : Board
        Made with `measuring_limits`.
    profile : Profile
        Its pulses.
    fast : bool
        For boards that nobody feels: not every step is sent.
    """

    def __init__(self, board: Board, profile: Profile, fast: bool = False) -> None:
        self._board = board
        self._limits = measuring_limits(profile)
        self._pulse = profile.pulse
        self._masked = profile.output.masked
        self._cathodic = "anodic" not in profile.output.polarities
        self._slew_ma_s = slew_ma_s(profile)
        self._fast = fast
        self._time_ns = 0
        self._next_ns = 0
        """Planned start of the next step, by the board's clock."""
        self._steps = 0
        self.level_ma = 0.0

    def set(self, site: int, level_ma: float, time_ns: int) -> None:
        """Set a level, or as much of it as the ramp allows by now.

        Raises
        ------
        SafetyError, BoardError
            As `Board.send` does; nothing flows then.
        """
        now_ns = self._board.clock.now_ns()
        # Current that was to go on at a time is late by then; where none flowed, nothing waits.
        due_ns = min(now_ns, self._next_ns) if self.level_ma > 0 else now_ns
        self._next_ns = now_ns + round(1e9 * TICK_S)
        # What a pause has saved up is not spent: every rise is a ramp.
        elapsed_s = min((time_ns - self._time_ns) / 1e9, 2 * TICK_S) if self._steps else 0.0
        level_ma = min(level_ma, self.level_ma + self._slew_ma_s * elapsed_s)
        turned_off = level_ma == 0 and self.level_ma > 0
        self.level_ma, self._time_ns = level_ma, time_ns
        due = not self._fast or turned_off or self._steps % _FAST_STEPS == 0
        self._steps += 1
        if due:
            self._send(site, level_ma, time_ns, due_ns)

    def reset(self) -> None:
        """Restart at zero: the board is new, or was lost and is back."""
        self.level_ma = 0.0
        self._steps = 0

    def _send(self, site: int, level_ma: float, time_ns: int, due_ns: int) -> None:
        period_us = round(1e6 / self._pulse.rate_hz)
        sequence = one_each(
            self._limits,
            round(1000 * level_ma),
            self._pulse.width_us,
            level_ma / self._limits.full_ma,
            time_ns,
            cathodic=self._cathodic,
            sites=[site],
            masked=self._masked,
            discharge_us=self._pulse.discharge_us,
            period_us=0 if self._fast else period_us,
        )
        steps = math.ceil(TICK_S * 1e6 / sequence.period_us)
        times = 1 if self._fast else steps + _SPARE_TIMES
        # A simulated subject waits for nothing: its computer's pauses are none of its time.
        self._board.send(sequence, times, None if self._fast else due_ns)


_FAST_STEPS = 20
"""Steps of simulated time of which one is sent."""
