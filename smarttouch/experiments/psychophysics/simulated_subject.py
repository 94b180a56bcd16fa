"""A simulated subject: applies an observer to delivered pulses, and answers by key."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smarttouch.base.errors import ExperimentError
from smarttouch.boards.board import Board
from smarttouch.emulator.emulated_boards import Pulses, SimulatedDriver
from smarttouch.experiments.psychophysics.experiment_source import ExperimentSource
from smarttouch.experiments.psychophysics.observers import (
    BlindObserver,
    Observer,
    SimulatedObserver,
)
from smarttouch.experiments.psychophysics.perceived_spikes import Interval
from smarttouch.experiments.psychophysics.trials import Trial
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile
from smarttouch.running.step import Listener, RunContext, StepResult

_LOOK_S = 0.25  # interval of an observer's decisions while a current rises (our own choice)


class Subject(Listener):
    """Subject that answers an experiment in place of a person."""

    def __init__(
        self,
        source: ExperimentSource,  # experiment to answer, by its keys
        observer: Observer,  # observer that decides
        look_s: float = _LOOK_S,  # interval of its decisions while a current rises
        reaction_s: float = 0.0,  # from such a decision to the key
    ) -> None:
        super().__init__()
        self._source, self._observer = source, observer
        self._look_s, self._reaction_s = look_s, reaction_s
        self._key: tuple[int, str] | None = None  # when the next key is pressed, ns, and which
        self._driver: SimulatedDriver | None = None
        self._starts: dict[tuple[int, int], dict[int, tuple[int, int]]] = {}
        """Time and discharge of each sequence by number, for each presentation and interval."""
        self._asked: Trial | None = None
        self._looked_ns = 0

    def start(self, run: RunContext) -> None:
        """Attach to the board: its record of delivered pulses is the observer's only input."""
        self.attend(run.board)

    def attend(self, board: Board) -> None:
        """Attach to a board, as `start` does."""
        if not isinstance(board.driver, SimulatedDriver):
            raise ExperimentError(
                "a simulated subject responds to simulated currents only: choose the board "
                "simulated:"
            )
        self._driver = board.driver

    def step(self, result: StepResult) -> None:
        """Follow a step; answer if a question is open."""
        playing, asking = self._source.playing, self._source.asking
        sequence = result.step.sequence
        if playing is not None and result.number is not None:
            if self._starts and next(iter(self._starts))[0] != playing[0]:
                self._starts.clear()
            discharge_us = int(sequence.discharge_us[0]) if sequence.slots else 0
            starts = self._starts.setdefault(playing, {})
            starts[result.number] = (sequence.time_ns, discharge_us)
            if self._source.rising is not None and sequence.slots:
                self._look(self._source.rising, sequence.time_ns, starts)
            elif self._source.rising is not None:
                # Where nothing flows, what was felt before counts no more.
                starts.clear()
                self._key = None
        elif asking is not None and asking is not self._asked:
            if key := self._answer(asking, list(self._starts.values())):
                self._source.press(key)
            self._starts.clear()
        self._asked = asking

    def _look(self, trial: Trial, time_ns: int, starts: dict[int, tuple[int, int]]) -> None:
        if len(starts) == 1:
            self._looked_ns = time_ns
        if self._key is None and time_ns - self._looked_ns >= self._look_s * 1e9:
            key = self._answer(trial, [starts])
            self._starts = {next(iter(self._starts)): {}}
            self._looked_ns = time_ns
            # As long as it is not felt, or not enough, there is no key.
            if key:
                self._key = time_ns + round(self._reaction_s * 1e9), key
        if self._key is not None and time_ns >= self._key[0]:
            self._source.press(self._key[1])
            self._starts = {next(iter(self._starts)): {}}
            self._looked_ns, self._key = time_ns, None

    def _answer(self, trial: Trial, parts: list[dict[int, tuple[int, int]]]) -> str:
        """Return the key of the observer's answer, empty if there is none."""
        assert self._driver is not None
        pulses = self._driver.take_pulses()
        felt = [interval_of(pulses, starts) for starts in parts]
        task = trial.task if trial.course is None else trial.course.task
        alternatives = ("y", "n") if trial.rises else trial.alternatives
        response = self._observer.respond(task, felt, alternatives)
        return next((key for key, says in trial.answers.items() if says == response), "")


def interval_of(pulses: Pulses, starts: dict[int, tuple[int, int]]) -> Interval:
    """Return the pulses that the sequences of one interval delivered, from
    `SimulatedDriver.take_pulses`.

    `starts` has, by the number of each sequence, when it began, ns, and the discharge after each of
    its slots, µs.
    """
    number, width_us, current_ua = pulses
    mine = np.isin(number, list(starts))
    number, width_us, current_ua = number[mine], width_us[mine], current_ua[mine]
    begin_ns = min((time_ns for time_ns, _ in starts.values()), default=0)
    at = np.array([starts[each] for each in number.tolist()], np.int64).reshape(-1, 2)
    taken_us = width_us.astype(np.float64) + at[:, 1]
    before_us = np.cumsum(taken_us) - taken_us
    first = np.flatnonzero(np.diff(number.astype(np.int64), prepend=-1))
    within_us = before_us - np.repeat(before_us[first], np.diff(np.append(first, len(number))))
    return Interval((at[:, 0] - begin_ns) / 1e9 + within_us / 1e6, width_us, current_ua)


def make_observer(
    kind: str,
    profile: Profile,  # profile of the finger whose spikes the model judges
    seed: int,  # of its noise
    finger: int = 1,  # seed of the model's finger
    anatomy: str | Path = "paper",  # of the model's finger
) -> Observer:
    """Return the observer of a kind: ``model``; or ``random``, ``first`` or ``silent``, for
    checks."""
    if kind != "model":
        return BlindObserver(kind, seed)
    judging = SimulatedObserver(Finger(profile, finger, anatomy), load_bank(profile), seed)
    return TwoLooks(judging, seed)


@dataclass
class TwoLooks:
    """Observer of two intervals made from one that detects a stimulus in a single interval.

    If it was felt in both or in none, a coin is tossed: so does a threshold that is either passed
    or not (high-threshold theory, Green and Swets, Signal Detection Theory and Psychophysics, 1966,
    chapter 5).
    """

    observer: Observer
    seed: int = 0  # of the coin

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def respond(
        self, task: str, intervals: Sequence[Interval], alternatives: Sequence[str]
    ) -> str | None:
        """Return the answer to a trial."""
        if task != "felt" or len(intervals) < 2:
            return self.observer.respond(task, intervals, alternatives)
        felt = [self.observer.respond(task, [each], ("y", "n")) == "y" for each in intervals]
        at = felt.index(True) if sum(felt) == 1 else int(self._random.integers(len(felt)))
        return alternatives[at]
