"""The threshold procedure of one electrode, and the currents that it may reach.

It ascends to limits: it returns the next level and takes whether a key was pressed; current and
timing are the caller's.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from smarttouch.boards.board import Board
from smarttouch.experiments.psychophysics.experiment_source import STEP_S
from smarttouch.experiments.psychophysics.procedures import middle_and_spread
from smarttouch.profile import Profile
from smarttouch.stimulation.safety_limits import LONGEST_RAMP_S


def measuring_profile(profile: Profile) -> Profile:
    """Return a profile that reaches above the comfort of one, which is to be measured.

    Current, charge, pulse, rate, duty, sums and single electrodes stay limited as they are, and
    so does the rise in mA a second.
    """
    full_ma, ramp_s = float(profile.full_ma.max()), profile.limits.ramp_s
    most_ma = min(_strongest_ma(profile), full_ma * LONGEST_RAMP_S / ramp_s)
    own = profile.limits.electrode_ma or (most_ma,) * len(profile.electrodes)
    ceilings_ma = [_whole_ua(min(most_ma, each)) for each in own]
    perception = profile.perception.model_dump() | {"comfort_ma": ceilings_ma}
    # Never faster, where single electrodes keep the ceilings below what was comfortable.
    slower = ramp_s * max(1.0, max(ceilings_ma) / full_ma)
    limits = profile.limits.model_dump() | {"ramp_s": min(LONGEST_RAMP_S, slower)}
    return Profile.model_validate(
        {**profile.model_dump(), "perception": perception, "limits": limits}
    )


def ceiling_ma(profile: Profile, site: int, board: Board) -> float:
    """Return the largest current of an electrode, mA: whole microamperes."""
    own = profile.limits.electrode_ma
    strongest = min(
        _strongest_ma(profile),
        math.inf if own is None else own[site],
        board.capabilities.max_current_ma,
    )
    return _whole_ua(strongest)


def slew_ma_s(profile: Profile, site: int) -> float:
    """Return the largest slope of an electrode's current, mA/s."""
    return float(profile.full_ma[site]) / profile.limits.ramp_s


def _strongest_ma(profile: Profile) -> float:
    limits = profile.limits
    by_charge = 1000 * limits.charge_uc / profile.pulse.width_us
    return min(limits.current_ma, by_charge, profile.total_ma)


def _whole_ua(current_ma: float) -> float:
    return math.floor(1000 * current_ma + 1e-6) / 1000


TICK_S = STEP_S  # one step of the procedure
RISE_S = 6.0  # time of the first run from zero to the expected threshold
REACTION_S = 0.35  # reaction time from feeling to the key; the level so long before the key counts
PAUSE_S = (1.0, 2.0)
"""Pause at zero before a run, of random length, so that time does not reveal the level."""
START_SHARE = (0.4, 0.7)  # later runs rise fast to a random part of the threshold found before
LEAP = 10  # factor by which they rise faster there
CEILING_S = 1.0  # time at the ceiling before a run is given up
MOST_APART = 1.4  # largest over smallest threshold of the runs above which more runs are made
EXTRA_RUNS = 2
HURRIED_S = 0.8
"""Time after the first key within which a second one is a held key, or a current that hurts."""
MOST_HURRIED = 2  # times that such runs are repeated before they are accepted
LEAST_ROOM = 1.05  # least ratio of comfort to threshold that leaves a usable range


@dataclass(frozen=True)
class Run:
    """Result of one rise; NaN for what was not reached before the ceiling."""

    threshold_ma: float
    comfort_ma: float


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of one electrode."""

    # threshold_ma, comfort_ma: medians of the runs. NaN if it was not felt up to the ceiling; the
    # ceiling where it was never enough.
    threshold_ma: float
    comfort_ma: float
    spread: float  # of the runs' thresholds, robust standard deviation over their median
    runs: int
    false_presses: int  # keys while no current flowed

    @property
    def felt(self) -> bool:
        return bool(np.isfinite(self.threshold_ma))

    @property
    def usable(self) -> bool:
        """True if comfort is far enough above the threshold."""
        return self.felt and self.comfort_ma >= LEAST_ROOM * self.threshold_ma


@dataclass
class AscendingLimits:
    """Ascending limits at one electrode.

    In a loop until `done`: make the current of `next` flow for `TICK_S`, then give
    `answer` whether a key was pressed meanwhile. In each run the first key means
    *felt*, the second *strong enough*.
    """

    ceiling_ma: float  # never exceeded
    expected_ma: float  # expected threshold; sets the slope of the current
    repeats: int = 3  # runs, if they agree
    fastest_ma_s: float = float("inf")  # the current rises no faster, whatever is expected
    seed: int | tuple[int, ...] = 0  # of pauses and starts
    runs: list[Run] = field(default_factory=list, init=False)
    false_presses: int = field(default=0, init=False)
    hurried: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        fastest_ma = self.fastest_ma_s * TICK_S
        wanted_ma = min(self.expected_ma, self.ceiling_ma) * TICK_S / RISE_S
        self._step_ma = min(wanted_ma, fastest_ma)
        self._leap_ma = min(LEAP * wanted_ma, fastest_ma)
        self._begin()

    @property
    def done(self) -> bool:
        if self.runs and np.isnan(self.runs[-1].threshold_ma):
            return True
        found = [run.threshold_ma for run in self.runs]
        if len(found) < self.repeats:
            return False
        apart = len(found) > 1 and max(found) > MOST_APART * min(found)
        return not apart or len(found) >= self.repeats + EXTRA_RUNS

    @property
    def felt(self) -> bool:
        """True if this run's first key has been pressed."""
        return bool(np.isfinite(self._threshold_ma))

    @property
    def task(self) -> str:
        """Kind of question that the next key answers."""
        return "enough" if self.felt else "felt"

    def next(self) -> float:
        """Return the level of the next step, mA."""
        if self._pause > 0:
            self._pause -= 1
            return 0.0
        level = self._levels[-1] if self._levels else 0.0
        rise = self._leap_ma if level < self._start_ma else self._step_ma
        self._levels.append(min(level + rise, self.ceiling_ma))
        return self._levels[-1]

    def answer(self, pressed: bool) -> None:
        """Take the answer: whether a key was pressed during the last step."""
        if not self._levels:
            if pressed:
                self.false_presses += 1
                self._pause = self._draw_pause()
            return
        if pressed:
            self._press()
        elif self._held_at_ceiling():
            self._end(self.ceiling_ma if self.felt else float("nan"))

    def restart(self) -> None:
        """Begin this run again from zero: the current was interrupted."""
        self._begin()

    def result(self) -> Thresholds:
        """Return the joint result of the runs."""
        threshold = np.array([run.threshold_ma for run in self.runs])
        comfort = np.array([run.comfort_ma for run in self.runs])
        if not len(threshold) or np.isnan(threshold).any():
            return Thresholds(np.nan, np.nan, np.nan, len(threshold), self.false_presses)
        middle = float(np.median(threshold))
        return Thresholds(
            middle,
            float(np.median(comfort)),
            middle_and_spread(threshold)[1] / middle,
            len(threshold),
            self.false_presses,
        )

    def _begin(self) -> None:
        self._levels: list[float] = []
        self._threshold_ma = float("nan")
        self._felt_at = 0
        self._pause = self._draw_pause()
        before = [run.threshold_ma for run in self.runs]
        self._start_ma = self._random.uniform(*START_SHARE) * min(before) if before else 0.0

    def _draw_pause(self) -> int:
        return round(self._random.uniform(*PAUSE_S) / TICK_S)

    def _press(self) -> None:
        level_ma = self._levels[max(0, len(self._levels) - 1 - round(REACTION_S / TICK_S))]
        if len(self._levels) <= round(REACTION_S / TICK_S):
            # Nobody reacts so fast: this key was for something else.
            self.false_presses += 1
            self.restart()
        elif not self.felt:
            self._threshold_ma, self._felt_at = level_ma, len(self._levels)
        elif self._hurried() and self.hurried < MOST_HURRIED:
            self.hurried += 1
            self.restart()
        else:
            self._end(level_ma)

    def _hurried(self) -> bool:
        return len(self._levels) - self._felt_at < round(HURRIED_S / TICK_S)

    def _held_at_ceiling(self) -> bool:
        """Return whether levels, which never fall in a run, have long been the highest."""
        steps = round(CEILING_S / TICK_S)
        return len(self._levels) > steps and self._levels[-1 - steps] >= self.ceiling_ma

    def _end(self, comfort_ma: float) -> None:
        self.runs.append(Run(self._threshold_ma, comfort_ma))
        if not self.done:
            self._begin()
