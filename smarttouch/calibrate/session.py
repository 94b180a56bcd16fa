"""Threshold session: many electrodes, one after the other, each result saved at once."""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from smarttouch.boards.board import Board
from smarttouch.calibrate.adaptive import AdaptiveThreshold
from smarttouch.calibrate.limits import TICK_S, AscendingLimits, Thresholds
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.stimulus import Stimulus, ceiling_ma, slew_ma_s
from smarttouch.calibrate.subject import SimulatedSubject
from smarttouch.errors import BoardError, BoardRestartedError, CalibrationError
from smarttouch.profile import Profile

TRIAL_S = 0.8
"""Time of a yes-no trial at its level."""
_MOST_RESTARTS = 3


class StoppedError(CalibrationError):
    """The stop key was pressed; all electrodes are at zero."""


class Subject(Protocol):
    """Subject of a session, a person or a simulated one, with its own clock."""

    def now_ns(self) -> int: ...

    def begin(self, site: int) -> None:
        """Begin another electrode."""

    def pressed(self, level_ma: float, seconds: float) -> bool:
        """Wait for a time; return whether a key was pressed meanwhile."""

    def felt(self, level_ma: float) -> bool:
        """Return whether the trial that has just ended was felt."""


class Person:
    """Person at a keyboard.

    Parameters
    ----------
    next_key : callable
        Returns a key that was pressed, waiting so many seconds for one at most; None if none.
    say : callable
        Shows a line.
    must_stop : callable
        Whether someone else asks for the end.
    """

    STOP_KEYS = ("q", "Q", "\x1b", "\x03", "\x04", "")
    _ASK_S = 0.2

    def __init__(
        self,
        next_key: Callable[[float], str | None],
        say: Callable[[str], None],
        must_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._next_key, self._say, self._must_stop = next_key, say, must_stop

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def begin(self, site: int) -> None:
        self._say(f"electrode {site}: a key when you feel it, again when it is strong enough")

    def pressed(self, level_ma: float, seconds: float) -> bool:
        end, any_key = time.monotonic() + seconds, False
        while (left := end - time.monotonic()) > 0:
            any_key = self._key(left) is not None or any_key
        return any_key

    def felt(self, level_ma: float) -> bool:
        self._say("felt? y or n")
        while True:
            key = self._key(self._ASK_S)
            if key in ("y", "Y", " ", "\n", "\r"):
                return True
            if key in ("n", "N"):
                return False

    def _key(self, seconds: float) -> str | None:
        key = self._next_key(seconds)
        if key in self.STOP_KEYS or self._must_stop():
            raise StoppedError("stopped")
        return key


class Simulated:
    """Simulated subject with simulated time.

    Parameters
    ----------
    subjects : sequence of SimulatedSubject
        One for each electrode.
    """

    def __init__(self, subjects: Sequence[SimulatedSubject]) -> None:
        self._subjects = subjects
        self._time_ns = 0
        self._site = 0

    def now_ns(self) -> int:
        return self._time_ns

    def begin(self, site: int) -> None:
        self._site = site

    def pressed(self, level_ma: float, seconds: float) -> bool:
        self._time_ns += round(seconds * 1e9)
        return self._subjects[self._site].presses(level_ma, seconds)

    def felt(self, level_ma: float) -> bool:
        return self._subjects[self._site].says_felt(level_ma, TRIAL_S)


@dataclass
class ThresholdSession:
    """Session that measures one electrode after the other on an open board.

    Attributes
    ----------
    board : Board
        Made with `measuring_limits`.
    profile : Profile
    subject : Subject
    adaptive : bool
        Whether yes-or-no trials follow the rising current.
    repeats : int
        Of the rising current.
    seed : int
        Of all that is drawn.
    fast : bool
        For boards that nobody feels.
    must_stop : callable
        Whether someone else asks for the end.
    """

    board: Board
    profile: Profile
    subject: Subject
    adaptive: bool = False
    repeats: int = 3
    seed: int = 0
    fast: bool = False
    must_stop: Callable[[], bool] = lambda: False
    _stimulus: Stimulus = field(init=False)

    def __post_init__(self) -> None:
        self._stimulus = Stimulus(self.board, self.profile, self.fast)

    def run(
        self,
        sites: Sequence[int],
        progress: Progress,
        show: Callable[[int, Thresholds], None],
    ) -> None:
        """Measure the remaining electrodes, and save each result.

        Raises
        ------
        StoppedError
            If the subject wanted it to end.
        """
        try:
            for site in sites:
                if site in progress.found:
                    continue
                self.subject.begin(site)
                found = self._measure(site)
                progress.keep(site, found)
                show(site, found)
        except BaseException:
            # A board that cannot be reached is gone; the first fault is what counts.
            with contextlib.suppress(BoardError):
                self.board.stop()
            raise

    def _measure(self, site: int) -> Thresholds:
        """Return the result of one electrode; a second attempt is made if it is implausible."""
        found = self._once(site, 0)
        if found.felt and not found.usable:
            found = self._once(site, 1)
        return found

    def _once(self, site: int, attempt: int) -> Thresholds:
        top_ma = ceiling_ma(self.profile, site, self.board)
        procedure = AscendingLimits(
            top_ma,
            float(self.profile.threshold_ma[site]),
            self.repeats,
            slew_ma_s(self.profile),
            (self.seed, site, attempt),
        )
        restarts = 0
        while not procedure.done:
            try:
                pressed = self._flow(site, procedure.next(), TICK_S)
            except BoardRestartedError:
                restarts += 1
                if restarts > _MOST_RESTARTS:
                    raise
                self._stimulus.reset()
                procedure.restart()
                continue
            procedure.answer(pressed)
        self._flow(site, 0.0, TICK_S)
        found = procedure.result()
        return self._refined(site, found) if self.adaptive and found.usable else found

    def _refined(self, site: int, rising: Thresholds) -> Thresholds:
        """Return the threshold by yes-or-no trials, none stronger than was comfortable."""
        procedure = AdaptiveThreshold(rising.threshold_ma, rising.comfort_ma, (self.seed, site, 2))
        while not procedure.done:
            level_ma = procedure.next()
            self._trial(site, level_ma)
            procedure.answer(self.subject.felt(level_ma))
        if not procedure.believable:
            raise CalibrationError(
                f"electrode {site}: {procedure.guessed} of {procedure.blanks} trials without any "
                "current were called felt: explain the task again, then run the same command again",
                about="blanks",
                problem="too many",
                value=procedure.guessed,
                electrode=site,
            )
        return Thresholds(
            procedure.threshold_ma,
            rising.comfort_ma,
            procedure.spread,
            rising.runs,
            rising.false_presses,
        )

    def _trial(self, site: int, level_ma: float) -> None:
        """Rise to a level, stay there, and go back to zero; begun again if the board was lost."""
        rise_s = level_ma / slew_ma_s(self.profile)
        steps = round((rise_s + TRIAL_S) / TICK_S)
        for attempt in range(_MOST_RESTARTS + 1):
            try:
                for step in range(steps + 1):
                    self._flow(site, level_ma if step < steps else 0.0, TICK_S)
            except BoardRestartedError:
                self._stimulus.reset()
                if attempt == _MOST_RESTARTS:
                    raise
            else:
                return

    def _flow(self, site: int, level_ma: float, seconds: float) -> bool:
        if self.must_stop():
            raise StoppedError("stopped")
        self._stimulus.set(site, level_ma, self.subject.now_ns())
        return self.subject.pressed(level_ma, seconds)


def simulated_subjects(profile: Profile, ceilings_ma: Sequence[float], seed: int) -> Simulated:
    """Return a simulated subject with varied electrodes, none above its ceiling."""
    random = np.random.default_rng(seed)
    subjects = []
    for site, top_ma in enumerate(ceilings_ma):
        usual = float(profile.threshold_ma[site])
        threshold = min(usual * float(np.exp(0.2 * random.standard_normal())), 0.6 * top_ma)
        comfort = min(threshold * random.uniform(1.5, 2.2), 0.95 * top_ma)
        subjects.append(SimulatedSubject(threshold, comfort, seed=seed + site))
    return Simulated(subjects)
