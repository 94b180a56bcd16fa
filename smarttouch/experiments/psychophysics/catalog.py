"""Experiments by name or file, and how to build each from the user's options.

What fails in those of a user's file or of another package is one sentence."""

import runpy
import traceback
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.base.files import require_file
from smarttouch.base.registry import Registry
from smarttouch.experiments.psychophysics.procedures import (
    REPETITIONS,
    STANDARDS_HZ,
    Condition,
    Procedure,
    constant_stimuli,
    detection_procedure,
    frequency_procedure,
    ratio_pairs,
    repeats,
)
from smarttouch.experiments.psychophysics.tasks import (
    DetectionTask,
    DiscomfortTask,
    FrequencyTask,
    LocalizationTask,
)
from smarttouch.experiments.psychophysics.trials import Stimuli, Task, Trial
from smarttouch.profile import Profile
from smarttouch.profile.profile import require_driven

_MOST_BYTES = 10_000_000
_T = TypeVar("_T")


def called(name: str, function: Callable[..., object], kind: type[_T], *arguments: object) -> _T:
    """Return what a function of an experiment returns; an ExperimentError if it fails or that is
    of another type."""
    try:
        given = function(*arguments)
    except SmartTouchError:
        raise
    except Exception as error:
        raise ExperimentError(
            f"{name} fails{_line_of(error)}: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(given, kind):
        raise ExperimentError(
            f"{name}: {getattr(function, '__qualname__', 'it')} returned {type(given).__name__}: "
            f"it must return a {kind.__name__}"
        )
    return given


def _line_of(error: BaseException) -> str:
    """Return where code outside of this package failed, in words; empty if nowhere."""
    if isinstance(error, SyntaxError):
        return f" in line {error.lineno}"
    own = str(Path(__file__).parents[2])
    outside = [
        each.lineno
        for each in traceback.extract_tb(error.__traceback__)
        if not each.filename.startswith((own, "<frozen"))
    ]
    return f" in line {outside[-1]}" if outside else ""


class OwnTask:
    """Task of a user, whose trials are checked."""

    def __init__(self, task: Task, name: str) -> None:
        self._task, self._name = task, name

    def __getattr__(self, name: str) -> Any:
        return getattr(self._task, name)

    def trial(self, condition: Condition) -> Trial:
        """Return the stimuli and the question of a condition."""
        return called(self._name, self._task.trial, Trial, condition)


CONSTANT, STAIRCASE, QUESTPLUS, LIMITS = "constant", "staircase", "questplus", "limits"
ADAPTIVE = (CONSTANT, STAIRCASE, QUESTPLUS)
PC_STANDARDS_HZ = (*STANDARDS_HZ, 90.0, 100.0)
"""Standards of PC: those of RA, and the two at which the paper's thresholds change (Fig. 18)."""
LEVELS = tuple(np.geomspace(0.5, 1.6, 7))
"""Levels of the detection experiment, as parts of the profile's threshold (our own choice)."""
_FARTHEST = 4  # most steps of distance to each side of a point

_IN_MA = ("detection", "discomfort")
_SLOWER = 2.0
"""Factor by which the rise of current is slower than the profile's ramp, in `discomfort`."""


@dataclass(frozen=True)
class ExperimentOptions:
    """Options of an experiment; None means not given."""

    afferent: Afferent = Afferent.RA
    procedure: str | None = None
    standards: tuple[float, ...] | None = None
    # repetitions, trials: of each condition (constant), of each standard (adaptive)
    repetitions: int | None = None
    trials: int | None = None
    site: int | None = None
    train_s: float | None = None
    rate_hz: float | None = None
    two_intervals: bool = False  # detection: in which of two, and not yes or no
    seed: int = 0


@dataclass(frozen=True)
class Design:
    """An experiment ready to be run."""

    task: Task
    procedure: Procedure
    method: str  # the procedure's name
    total: int | None = None  # number of trials; None if it depends on the answers
    again: bool = True  # whether a trial may be repeated
    notes: list[str] = field(default_factory=list)  # warnings for the user


@dataclass(frozen=True)
class Experiment:
    """One experiment: what it asks, and the function that puts it together."""

    about: str  # in one line
    make: Callable[[Stimuli, ExperimentOptions, str], Design]  # called with the procedure's name
    methods: tuple[str, ...] = (CONSTANT,)  # procedures that make sense, the usual one first
    train_s: float = 0.5  # default length of a train


EXPERIMENTS = Registry("smarttouch.experiments", Experiment, ExperimentError, {})
"""Entry points of other packages; each names an `Experiment`."""


def find_experiment(name: str) -> Experiment:
    """Return an experiment by its name in the catalog, by its file, or of another package."""
    if name in CATALOG:
        return CATALOG[name]
    if name.endswith(".py"):
        return _experiment_of_file(name)
    known = [*CATALOG, *EXPERIMENTS.plug_ins]
    if name not in known:
        raise ExperimentError(
            f"there is no experiment {name!r}: choose {' or '.join(known)}, or give a file of "
            "your own, as in mine.py"
        )
    found: Experiment = EXPERIMENTS.load(name)
    EXPERIMENTS.require_kind(found, name)
    return found


def _experiment_of_file(name: str) -> Experiment:
    require_file(Path(name), ExperimentError, _MOST_BYTES)
    found = called(name, runpy.run_path, dict, name)
    made = {id(each): each for each in found.values() if isinstance(each, Experiment)}
    if len(made) != 1:
        raise ExperimentError(
            f"{name} has {len(made) or 'no'} Experiment{'s' * (len(made) > 1)}: make one, as in "
            "experiment = Experiment('what it asks', make)"
        )
    return next(iter(made.values()))


def new_experiment(name: str, profile: Profile, wanted: ExperimentOptions) -> Design:
    """Build an experiment of the catalog, of a file or of another package."""
    entry = find_experiment(name)
    method = wanted.procedure or entry.methods[0]
    if method not in entry.methods:
        raise ExperimentError(
            f"the procedure {method!r} is not for {name}: choose {' or '.join(entry.methods)}"
        )
    if wanted.site is not None:
        require_driven(profile, [wanted.site], ExperimentError, "site")
    if name in _IN_MA and profile.pulse.carrier == "width":
        raise ExperimentError(
            f"{name} counts in mA, and intensity changes the width of this profile's pulses: set "
            "pulse.carrier = 'height'"
        )
    train_s = entry.train_s if wanted.train_s is None else wanted.train_s
    stimuli = Stimuli(profile, wanted.afferent, train_s)
    if name in CATALOG:
        return entry.make(stimuli, wanted, method)
    made = called(name, entry.make, Design, stimuli, wanted, method)
    if not isinstance(made.procedure, Generator):
        raise ExperimentError(
            f"{name}: the procedure of its Design is a {type(made.procedure).__name__}: give a "
            "generator of conditions, such as constant_stimuli makes"
        )
    return replace(made, task=OwnTask(made.task, name))


def _site(stimuli: Stimuli, wanted: ExperimentOptions) -> int:
    return stimuli.middle if wanted.site is None else wanted.site


def _rate_hz(stimuli: Stimuli, wanted: ExperimentOptions) -> float:
    return stimuli.profile.pulse.rate_hz if wanted.rate_hz is None else wanted.rate_hz


def _constant(
    pairs: Sequence[tuple[float, float]], wanted: ExperimentOptions, two_intervals: bool, usual: int
) -> tuple[Procedure, int]:
    """Return the procedure, and its number of trials."""
    repetitions = usual if wanted.repetitions is None else wanted.repetitions
    procedure = constant_stimuli(pairs, repetitions, two_intervals, wanted.seed)
    return procedure, len(pairs) * repetitions


def _frequency(stimuli: Stimuli, wanted: ExperimentOptions, method: str) -> Design:
    standards = wanted.standards or (
        PC_STANDARDS_HZ if stimuli.afferent is Afferent.PC else STANDARDS_HZ
    )
    highest_hz = stimuli.profile.limits.rate_hz
    notes = []
    if stimuli.afferent is Afferent.PC:
        notes.append(
            f"PC is stimulated by {stimuli.profile.name or 'this profile'}'s own PC kernel: the "
            "paper's large electrode (Fig. 17) has no printed size"
        )
    if method == CONSTANT:
        pairs = ratio_pairs(standards, highest=highest_hz)
        left_out = len(ratio_pairs(standards)) - len(pairs)
        if left_out:
            notes.append(
                f"{left_out} comparisons above the profile's limit of {highest_hz:g} Hz are not "
                "offered"
            )
        procedure, total = _constant(pairs, wanted, True, REPETITIONS)
    else:
        procedure = frequency_procedure(method, standards, highest_hz, wanted.trials, wanted.seed)
        total = None
    task = FrequencyTask(stimuli, _site(stimuli, wanted))
    return Design(task, procedure, method, total, notes=notes)


def _detection(stimuli: Stimuli, wanted: ExperimentOptions, method: str) -> Design:
    site = _site(stimuli, wanted)
    threshold_ma, full_ma = (
        float(each[site]) for each in (stimuli.profile.threshold_ma, stimuli.profile.full_ma)
    )
    if method == CONSTANT:
        levels = sorted({min(round(threshold_ma * each, 3), full_ma) for each in LEVELS})
        if not wanted.two_intervals:
            levels = [0.0, *levels]
        pairs = [(0.0, each) for each in levels]
        procedure, total = _constant(pairs, wanted, wanted.two_intervals, REPETITIONS)
    else:
        total = None
        procedure = detection_procedure(
            method, threshold_ma, full_ma, wanted.two_intervals, wanted.trials, wanted.seed
        )
    task = DetectionTask(stimuli, site, _rate_hz(stimuli, wanted))
    # A repetition would give more information than one presentation.
    return Design(task, procedure, method, total, again=False)


def _discomfort(stimuli: Stimuli, wanted: ExperimentOptions, method: str) -> Design:
    slowest_s = _SLOWER * stimuli.profile.limits.ramp_s
    if stimuli.train_s < slowest_s:
        raise ExperimentError(
            f"a current that reaches discomfort in {stimuli.train_s:g} s comes too suddenly: let "
            f"trains last {slowest_s:g} s or more"
        )
    task = DiscomfortTask(stimuli, _site(stimuli, wanted), _rate_hz(stimuli, wanted))
    total = 5 if wanted.repetitions is None else wanted.repetitions
    return Design(task, repeats(total), method, total, again=False)


def _localization(stimuli: Stimuli, wanted: ExperimentOptions, method: str) -> Design:
    site = _site(stimuli, wanted)
    beside = stimuli.beside(site)
    far_mm = sorted({abs(each) for each in beside if -each in beside})[:_FARTHEST]
    if not far_mm:
        raise ExperimentError(
            f"site {site} has no neighbors as far left as right: choose one in the middle of a row"
        )
    pairs = [(0.0, sign * each) for each in far_mm for sign in (-1, 1)]
    task = LocalizationTask(stimuli, site, _rate_hz(stimuli, wanted))
    procedure, total = _constant(pairs, wanted, False, REPETITIONS)
    return Design(task, procedure, method, total)


CATALOG = {
    "frequency": Experiment("which of two is faster (paper, III-C)", _frequency, ADAPTIVE, 1.0),
    "detection": Experiment("is it felt: threshold current, mA", _detection, ADAPTIVE),
    "discomfort": Experiment("when is a rising current enough, mA", _discomfort, (LIMITS,), 10.0),
    "localization": Experiment("was the second left or right: distance, mm", _localization),
}
"""The package's own experiments by name."""
