"""The level at which a finger reads letters best, by yes-or-no answers and named letters.

A lone disc's thresholds of both polarities come first: their ratio says which anatomy the finger is
like, and the anodic one about where letters begin to be read. Letters at a few levels follow, each
at the level whose answer says most, until no other level can be expected to be clearly better.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import CalibrationError
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.experiments.calibration.profile_file import ProfileFile
from smarttouch.experiments.calibration.thresholds import Keys, Prompts, present
from smarttouch.experiments.psychophysics.adaptive_procedures import entropy
from smarttouch.experiments.psychophysics.experiment_session import TrialSession
from smarttouch.experiments.psychophysics.experiment_source import ExperimentSource
from smarttouch.experiments.psychophysics.observers import SimulatedObserver
from smarttouch.experiments.psychophysics.polarity import (
    PolarityRatio,
    polarity_procedure,
    polarity_range,
    polarity_ratio,
)
from smarttouch.experiments.psychophysics.procedures import Condition, Procedure
from smarttouch.experiments.psychophysics.simulated_subject import Subject
from smarttouch.experiments.psychophysics.tasks import LetterTask, PolarityTask, middle_discs
from smarttouch.experiments.psychophysics.trial_rows import About, RowFile
from smarttouch.experiments.psychophysics.trials import Stimuli, Trial, TrialTiming
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.kernels.disc_banks import lone_discs
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.listener import Listener

Array = NDArray[np.float64]

ANATOMIES = ("paper", "branched")
LEVELS = np.array([0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0])
"""Levels that may be found, as parts of the strongest comfortable current."""
SHOWN = np.array([0.3, 0.4, 0.5, 0.7, 1.0])  # levels at which letters are shown
_FIRST = 2  # highest of these that is shown first; later ones are at most one step above all before
MOST_ANSWERS = 60
FEWEST_LETTERS = 8
ENOUGH_REGRET = 0.003
"""Expected share of letters lost by the best known level, below which no more are shown."""

_RATIO = np.array([[-0.35, 0.12], [0.3, 0.12]])
"""Natural logarithm of cathodic over anodic threshold of middle discs: mean and standard deviation
over fingers, of each anatomy. These and the next three are of 12 simulated fingers each
(`examples/studies/reading_levels.py`), with gain, depth and direction varied."""
_CROSSING = np.array([[-0.27, 0.12], [-0.03, 0.12]])
"""Of the current at which half of the letters are read, over the disc's anodic threshold."""
_APART = np.arange(-0.52, 1.44, 0.15)
_WRONG = np.array([
    [1.0, 0.98, 0.88, 0.67, 0.32, 0.12, 0.049, 0.024, 0.017, 0.015, 0.020, 0.022, 0.022, 0.022],
    [1.0, 0.97, 0.89, 0.69, 0.29, 0.10, 0.040, 0.016, 0.012, 0.018, 0.036, 0.048, 0.056, 0.078],
])  # fmt: skip
"""Share of letters read wrongly by the logarithm of level over that current."""
_LAPSES = np.array([0.02, 0.1, 0.2, 0.4])
"""Shares of answers that have nothing to do with the letter, all alike beforehand. Ours."""
_OFFSETS = np.linspace(-3.0, 3.0, 61)  # crossings on the grid, in standard deviations
_AT_AN_END = 1.08
"""Factor from the ends of the range within which both thresholds mean that all answers were one."""


class LevelBelief:
    """Posterior of anatomy, crossing and lapses, by the polarity test and letters since then."""

    def __init__(self, polarity: PolarityRatio, full_ma: float) -> None:
        off = math.log(polarity.ratio) - _RATIO[:, 0]
        spread = np.hypot(_RATIO[:, 1], polarity.log_spread)
        anatomy = np.exp(-((off / spread) ** 2) / 2) / spread
        anodic = polarity.anodic
        unsure = np.hypot(_CROSSING[:, 1], anodic.spread / anodic.threshold)
        crossing = math.log(anodic.threshold / full_ma) + _CROSSING[:, :1]
        self._crossing = crossing + unsure[:, None] * _OFFSETS
        weight = anatomy[:, None, None] * np.exp(-(_OFFSETS**2) / 2)[:, None]
        weight = weight * np.ones(len(_LAPSES))
        self._weight: Array = weight / weight.sum()
        self._right = self._chance_right(SHOWN)

    @property
    def anatomies(self) -> Array:
        """Probability of each anatomy, (2,)."""
        return np.asarray(self._weight.sum(axis=(1, 2)))

    @cached_property
    def _wrong(self) -> Array:
        """Share of letters read wrongly at each of `LEVELS`, (2, K, L), apart from lapses."""
        return self._wrong_at(LEVELS)

    @property
    def expected(self) -> Array:
        """Expected share of letters read wrongly at each of `LEVELS`, (L,), apart from lapses."""
        return np.asarray(np.einsum("ak,akl->l", self._weight.sum(axis=2), self._wrong))

    @property
    def regret(self) -> float:
        """Expected share of letters that are lost since the best level is not known."""
        best = (self._weight.sum(axis=2) * self._wrong.min(axis=2)).sum()
        return float(self.expected.min() - best)

    def next(self, highest: int) -> int:
        """Return the place in `SHOWN`, at most the highest, of the most informative level."""
        right = np.einsum("akj,akjl->l", self._weight, self._right)
        sure = np.einsum("akj,akjl->l", self._weight, entropy(self._right))
        return int((entropy(right) - sure)[: highest + 1].argmax())

    def take(self, shown: int, right: bool) -> None:
        """Take an answer at a place in `SHOWN`."""
        likely = self._right[..., shown]
        self._weight = self._weight * (likely if right else 1 - likely)
        self._weight /= self._weight.sum()

    def _wrong_at(self, levels: Array) -> Array:
        apart = np.log(levels) - self._crossing[..., None]
        return np.stack(
            [np.interp(*each) for each in zip(apart, [_APART] * 2, _WRONG, strict=True)]
        )

    def _chance_right(self, levels: Array) -> Array:
        """Return the probability of a right answer, (2, K, lapses, L)."""
        read = 1 - self._wrong_at(levels)[:, :, None]
        lapse = _LAPSES[:, None]
        return np.asarray((1 - lapse) * read + lapse / len(ALPHABET))


@dataclass(frozen=True)
class LevelFound:
    """Level at which letters are read best, and the anatomy that the finger is like."""

    level: float
    anatomy: str
    probability: float  # of the anatomy
    expected_wrong: float  # share of letters at that level, apart from lapses
    polarity: PolarityRatio
    answers: int

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        return (
            f"letters are read best at {self.level:g} of comfort, {self.expected_wrong:.0%} wrong "
            f"expected; the finger is like {self.anatomy} (probability {self.probability:.2f}), "
            f"{self.polarity}; {self.answers} answers"
        )


class LevelProcedure(Procedure):
    """Procedure of at most sixty answers: the polarity test, then letters (see `Procedure`).

    Conditions of index 0 and 1 are currents of a lone disc, anodic and cathodic, in mA; those from
    2 on letters of the alphabet, at a level.
    """

    def __init__(self, profile: Profile, seed: int = 0) -> None:
        sites = middle_discs(profile)
        self._polarity = polarity_procedure(profile, sites, None, seed)
        self._full_ma = float(profile.full_ma[sites].mean())
        low_ma, high_ma = polarity_range(profile, sites)
        self._least_ma, self._most_ma = low_ma * _AT_AN_END, high_ma / _AT_AN_END
        self._random = np.random.default_rng([seed, 3])
        self._belief: LevelBelief | None = None
        self._letters: list[int] = []
        self._answers = self._named = 0
        self._highest = _FIRST - 1
        self._shown: tuple[int, Condition] | None = None

    @property
    def done(self) -> bool:
        """Whether the level is known well enough, or all answers are used."""
        if self._belief is None:
            return False
        enough = self._named >= FEWEST_LETTERS and self._belief.regret < ENOUGH_REGRET
        return enough or self._answers >= MOST_ANSWERS

    def next(self) -> Condition:
        """Return the next condition; the same until it is answered."""
        if self._belief is None:
            return self._polarity.next()
        if self._shown is None:
            self._letters = self._letters or self._random.permutation(len(ALPHABET)).tolist()
            at = self._belief.next(min(self._highest + 1, len(SHOWN) - 1))
            shown = Condition(0.0, float(SHOWN[at]), 0, self._named, 2 + self._letters.pop())
            self._shown = at, shown
        return self._shown[1]

    def answer(self, success: bool | None) -> None:
        """Take whether it was felt, or named rightly; None counts as an answer that says nothing.

        Raises a CalibrationError if the answers to the polarity test were all alike.
        """
        self.next()
        self._answers += 1
        if self._belief is None:
            self._polarity.answer(success)
            if self._polarity.done:
                self._belief = LevelBelief(self._tested(), self._full_ma)
            return
        assert self._shown is not None
        at, self._shown = self._shown[0], None
        self._named += 1
        self._highest = max(self._highest, at)
        if success is not None:
            self._belief.take(at, success)

    @staticmethod
    def letter_of(condition: Condition) -> str | None:
        """Return the letter of a condition; None of the polarity test."""
        return ALPHABET[condition.index - 2] if condition.index >= 2 else None

    @property
    def found(self) -> LevelFound:
        """Level and anatomy by the answers until now; the polarity test must be over."""
        belief = self._belief
        assert belief is not None
        expected, anatomies = belief.expected, belief.anatomies
        at, like = int(expected.argmin()), int(anatomies.argmax())
        return LevelFound(
            float(LEVELS[at]), ANATOMIES[like], float(anatomies[like]), float(expected[at]),
            self._tested(), self._answers,
        )  # fmt: skip

    def _tested(self) -> PolarityRatio:
        tested = polarity_ratio(self._polarity)
        found = (tested.anodic.threshold, tested.cathodic.threshold) if tested else (math.inf,)
        if max(found) < self._least_ma or min(found) > self._most_ma:
            raise CalibrationError(
                "a lone disc was felt always or never, with both polarities: explain the task "
                "again, calibrate thresholds, then start over"
            )
        assert tested is not None
        return tested


class LevelTask:
    """Task of a `LevelProcedure`: a lone disc, or a letter at a level."""

    def __init__(self, profile: Profile, train_s: float = 0.5) -> None:
        stimuli, rate_hz = Stimuli(profile, Afferent.RA, train_s), profile.pulse.rate_hz
        self._disc = PolarityTask(stimuli, middle_discs(profile), rate_hz)
        self.drawn = {each: draw_letter(each, profile) for each in ALPHABET}
        self._letter = LetterTask(stimuli, self.drawn, rate_hz)

    def trial(self, condition: Condition) -> Trial:
        """Return the stimuli and the question of a condition."""
        letter = LevelProcedure.letter_of(condition)
        if letter is None:
            return self._disc.trial(condition)
        trial = self._letter.trial(Condition(0.0, float(ALPHABET.index(letter)), 0, 0, 0))
        (train,) = trial.intervals
        return replace(
            trial, condition=condition, intervals=(replace(train, level=condition.comparison),),
            words=f"letter at {condition.comparison:g} of comfort", unit="level", exact=True,
        )  # fmt: skip


_PATIENCE_S = 10.0
_SPOILED = 10  # times that current may be lost in one trial, by the board or a lifted finger


def answers_of(file: ProfileFile) -> Path:
    """Return the path of the answers beside a profile's file."""
    return file.beside("level.csv")


def simulated_person(
    profile: Profile, finger: tuple[str, int], drawn: Mapping[str, NDArray[np.float32]], seed: int
) -> SimulatedObserver:
    """Return an observer with a finger, by its anatomy and seed, of whose answers a tenth have
    nothing to do with what was shown."""
    anatomy, number = finger
    return SimulatedObserver(
        Finger(profile, number, anatomy), load_bank(profile), seed,
        guess=0.05, lapse=0.1, letter_noise=0.0, templates=drawn,
    )  # fmt: skip


def _kernels(profile: Profile) -> KernelBank:
    return lone_discs(profile, load_bank(profile))


def measure_level(
    file: ProfileFile,
    board_url: str,
    *,
    keys: Keys,
    say: Callable[[str], None],  # shows a line
    stop: StopRequest,
    opened: Callable[[Board, StopRequest], AbstractContextManager[Board]],
    force: str | None = None,  # URL of the finger's force; see `Runner`
    seed: int = 0,
    # anatomy and seed of a simulated person who answers, on the board ``simulated:``
    person: tuple[str, int] | None = None,
) -> LevelFound:
    """Measure level and anatomy of the finger of a profile's file, and set them there, not written
    yet.

    Answers are rows of a file beside it, from which the same call goes on; it is to be removed once
    the profile is written. Raises a CalibrationError if stopped before.
    """
    profile = file.profile
    procedure, task = LevelProcedure(profile, seed), LevelTask(profile)
    about = About("level", "questplus", profile.name, "simulated" * (person is not None), seed)
    begun = datetime.now(UTC).isoformat(timespec="seconds")
    display = Display(board_url if person is None else "simulated:", profile)
    with RowFile(answers_of(file), about) as rows:
        session = TrialSession(task, procedure, rows, begun)
        timing = TrialTiming(
            answer_s=None, patience_s=None if person is None else _PATIENCE_S, most_spoiled=_SPOILED
        )
        source = ExperimentSource(session, profile, timing)
        if not session.over:
            if person is None:
                task_words = "Say whether you feel anything, then which letter it is, in capitals"
                listener: Listener = Prompts(source, say, task_words)
            else:
                listener = Subject(source, simulated_person(profile, person, task.drawn, seed))
            config = RunConfig(mode="color", seed=seed)
            present(source, display, config, listener, keys, stop, opened, force, _kernels)
        if not procedure.done:
            raise CalibrationError(
                f"stopped, all electrodes are off: {session.done} answers are kept, the same "
                "command goes on there"
            )
    found = procedure.found
    file.set("perception.level", found.level)
    file.set("perception.anatomy", found.anatomy)
    return found
