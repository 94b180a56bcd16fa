"""Simulated participants with known thresholds, and experiments on a simulated board."""

import contextlib
import math
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from scipy.special import ndtr

from smarttouch.base.stopping import StopRequest
from smarttouch.experiments.answer_file import COLUMNS, Answers, parse_cells
from smarttouch.experiments.experiment_session import open_experiment
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.loop import Controls
from smarttouch.running.runner import Runner
from smarttouch.running.step_records import OnEvent, OnStep


@dataclass(frozen=True)
class Subject:
    """Participant whose chance of success is the normal CDF of the comparison's logarithm.

    At the comparison `threshold`, the chance of success is `level`, without guesses and lapses.
    """

    threshold: float
    spread: float
    level: float = 0.75
    lapse: float = 0.0
    guess: float | None = None

    def probability(self, comparison):
        # Normal quantiles of the two levels that tests use.
        offset = {0.75: 0.6744897501960817, 0.5: 0.0}[self.level]
        with np.errstate(divide="ignore"):
            z = (np.log(comparison) - np.log(self.threshold)) / self.spread + offset
        guess = self.lapse if self.guess is None else self.guess
        return guess + (1 - guess - self.lapse) * ndtr(z)


def answer_all(procedure, probability, seed=0):
    """Answer a procedure at random; ``probability`` maps a comparison to the chance of success."""
    random = np.random.default_rng(seed)
    success = []

    def answer(condition):
        success.append(bool(random.random() < probability(condition.comparison)))
        return success[-1]

    return as_answers(ask_all(procedure, answer), success)


def read_rows(path):
    """Return the rows of a file of answers, one for each trial."""
    return parse_cells(path.read_bytes(), path).rows(COLUMNS)


def ask_all(procedure, answer=lambda _condition: True):
    """Return all conditions that a procedure shows; ``answer`` maps a condition to its answer."""
    shown, condition = [], next(procedure, None)
    with contextlib.suppress(StopIteration):
        while condition is not None:
            shown.append(condition)
            condition = procedure.send(answer(condition))
    return shown


def as_answers(shown, success, standard=None):
    interval = np.array([each.comparison_interval for each in shown], np.int64)
    return Answers(
        shown[0].standard if standard is None else standard,
        np.array([each.comparison for each in shown]),
        np.array([np.nan if each is None else each for each in success], float),
        interval,
        2 if interval.any() else 0,
    )


def of_counts(stimulus, n, k, standard=0.0, alternatives=0):
    """Return answers with ``k`` successes in ``n`` trials at each stimulus."""
    comparison = np.repeat(np.asarray(stimulus, float), n)
    success = np.concatenate(
        [[1.0] * yes + [0.0] * (all_ - yes) for all_, yes in zip(n, k, strict=True)]
    )
    nothing = np.zeros(len(success), np.int64)
    return Answers(standard, comparison, success, nothing, alternatives)


@dataclass
class SimulatedSubject:
    """Participant who presses a key at the threshold of one electrode, then at its comfort level.

    Every 0.5 s the participant compares the current with the next of these two levels. `slope` is
    the standard deviation of a level in natural logarithms, `guess` the rate of false detections,
    `lapse` the rate of misses, and `drift` the relative rise of the levels per minute.
    A key follows a detection after `reaction_s`, with a standard deviation of about 25 %.
    """

    threshold_ma: float
    comfort_ma: float
    slope: float = 0.1
    guess: float = 0.005
    lapse: float = 0.03
    reaction_s: float = 0.35
    drift: float = 0.0
    seed: int = 0

    def __post_init__(self):
        self._random, self._minutes = np.random.default_rng(self.seed), 0.0
        self._forget()

    def _forget(self):
        self._sought_ma = [self.threshold_ma, self.comfort_ma]
        self._key_in_s, self._look_in_s = math.inf, self._random.uniform(0, 0.5)

    def presses(self, level_ma, seconds):
        """Return whether the participant presses a key during a step at one current."""
        self._minutes += seconds / 60
        if level_ma == 0:
            self._forget()
        elif self._key_in_s < math.inf:
            self._key_in_s -= seconds
            if self._key_in_s <= 0:
                self._key_in_s = math.inf
                self._sought_ma.reverse()
                return True
        else:
            self._look_in_s -= seconds
            if self._look_in_s <= 0:
                self._look_in_s += 0.5
                middle_ma = self._sought_ma[0] * (1 + self.drift * self._minutes)
                found = float(ndtr(math.log(level_ma / middle_ma) / self.slope))
                chance = self.guess + (1 - self.guess - self.lapse) * found
                if self._random.random() < chance:
                    jitter = math.exp(0.25 * self._random.standard_normal())
                    self._key_in_s = self.reaction_s * jitter
        return False


@dataclass
class Perfect:
    """Observer that compares pulse rates and counts without error, and stores all intervals."""

    felt: list = field(default_factory=list)

    def respond(self, task, intervals, alternatives):
        self.felt.append((task, intervals))
        pulses = [len(each.time_s) for each in intervals]
        if task == "faster":
            return str(1 + int(np.argmin([np.diff(each.time_s).mean() for each in intervals])))
        if len(intervals) == 2:
            return str(1 + int(np.argmax(pulses)))
        return "y" if pulses[0] else "n"


class Silent:
    """Observer that never answers."""

    def respond(self, task, intervals, alternatives):
        return None


class Sat(SimpleNamespace):
    """Result of an experiment: its source, rows, figures, and events. An event is (time, text)."""

    def events(self, start):
        """Return the texts of the events that begin with ``start``."""
        return [words for _, words in self.told if words.startswith(start)]


def sit(
    name, setup, bank, path, observer, *, stop_after=None, watch=None, controls=None, force=None
):
    """Run an experiment to its end, or until a trial begins after ``stop_after`` stored rows."""
    stop, told = StopRequest(), []
    with open_experiment(name, setup, path, "p1", "s1") as sitting:
        source = sitting.source(observer)

        def observe(sent):
            if watch is not None:
                watch(sent, source, controls)
            playing = source.title.endswith(("first", "second", "feel"))
            if stop_after is not None and len(sitting.file.rows) >= stop_after and playing:
                stop.ask("killed")

        statistics = Runner(
            source,
            Display("simulated:", setup.profile),
            RunConfig(mode=setup.afferent.name, scan="points"),
            listeners=[
                OnStep(observe),
                OnEvent(lambda event: told.append((event.time_ns, str(event)))),
            ],
            stop=stop,
            force=force,
            load_kernels=lambda _profile: bank,
            controls=Controls if controls is None else lambda _state, _modes: controls,
        ).run()
        return Sat(source=source, rows=sitting.file.rows, told=told, figures=statistics.figures)
