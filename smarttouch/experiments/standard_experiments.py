"""Catalog of the package's experiments, and loading of users' experiments from files. An error in a
user's file becomes an ExperimentError that names the line."""

import math
import runpy
import traceback
from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.base.files import require_file
from smarttouch.experiments.procedures import (
    ADAPTIVE,
    CONSTANT,
    LIMITS,
    STANDARDS_HZ,
    WIDEST_RATIO,
    Condition,
    Procedure,
    adaptive,
    interleave,
    ratio_pairs,
)
from smarttouch.experiments.trials import (
    LEFT_OR_RIGHT,
    STEP_S,
    Course,
    Setup,
    Train,
    Trial,
    Trials,
    ask,
    in_two_intervals,
)

_MOST_BYTES = 10_000_000
PC_STANDARDS_HZ = (*STANDARDS_HZ, 90.0, 100.0)
"""Standards for PC, Hz: `STANDARDS_HZ`, and two higher frequencies (paper, Fig. 18)."""
_NARROWEST_RATIO = 1.01  # smallest ratio of comparison to standard in adaptive procedures
_START_RATIO = 1.6  # first ratio of comparison to standard in a staircase
_STEP = 0.03
"""Relative step down in a frequency staircase: small against 20 %, the threshold for vibration."""
LEVELS = tuple(np.geomspace(0.5, 1.6, 7))
"""Levels of the detection experiment, relative to the profile's threshold (our own choice)."""
_DETECTION_STEP = 0.05  # step down in a detection staircase, relative to the comparison
_DETECTION_RANGE = (0.3, 3.0)  # range of levels, relative to the profile's threshold
SOFTNESSES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0)  # each compared with softness 0 (our own choice)
_FARTHEST = 4  # largest offset in `localization`, in electrodes
_DISCOMFORTS = 5  # default number of trials of `discomfort`
_SLOWER = 2.0
"""Smallest rise time of the current in `discomfort`, divided by the ramp time of the profile."""


@dataclass(frozen=True)
class Experiment:
    """One experiment: its question and the generator of its trials."""

    about: str  # question to the participant, in one line
    trials: Callable[[Setup], Trials]
    procedures: tuple[str, ...] = (CONSTANT,)  # allowed procedures, the default first
    train_s: float = 0.5  # default duration of a pulse train


def frequency(setup: Setup) -> Trials:
    """Ask which of two pulse trains of the same duration is faster (paper, Section III.C)."""
    is_pc = setup.afferent is Afferent.PC
    standards = setup.standards_hz or (PC_STANDARDS_HZ if is_pc else STANDARDS_HZ)
    highest_hz = setup.profile.limits.rate_hz
    if is_pc:
        setup.notes.append(
            f"PC is stimulated by the PC kernel of {setup.profile.name or 'this profile'}, not by "
            "the paper's large electrode, whose size is unknown (Fig. 17)"
        )

    def trial(condition: Condition) -> Trial:
        standard, comparison = condition.standard, condition.comparison
        at = condition.comparison_interval
        comparison_train, other = (
            setup.train([setup.place], rate_hz) for rate_hz in (comparison, standard)
        )
        target = "" if comparison == standard else str(at if comparison > standard else 3 - at)
        return in_two_intervals(
            condition, comparison_train, other, "faster", "which was faster?", "Hz", target=target
        )

    if setup.procedure == CONSTANT:
        pairs = ratio_pairs(standards, highest=highest_hz)
        if left_out := len(ratio_pairs(standards)) - len(pairs):
            setup.notes.append(
                f"{left_out} comparisons above the profile's limit of {highest_hz:g} Hz are left "
                "out"
            )
        procedure = setup.constant(pairs)
    else:
        procedure = _faster(setup, standards, highest_hz)
    yield from ask(procedure, trial)


def _faster(setup: Setup, standards: tuple[float, ...], highest_hz: float) -> Procedure:
    """Return adaptive procedures, interleaved at random. Each procedure finds the upper threshold
    of one standard."""
    procedures = []
    for index, standard in enumerate(standards):
        low, high = _NARROWEST_RATIO * standard, min(WIDEST_RATIO * standard, highest_hz)
        if high <= low:
            raise ExperimentError(
                f"the profile's limit of {highest_hz:g} Hz leaves no comparison above the standard "
                f"of {standard:g} Hz: give lower standards"
            )
        procedures.append(
            adaptive(
                setup.procedure, _START_RATIO * standard, _STEP, low, high, standard,
                setup.trials, seed=setup.seed + 1000 * index,
            )
        )  # fmt: skip
    return interleave(procedures, setup.seed)


def detection(setup: Setup) -> Trials:
    """Ask whether the participant feels a pulse train.

    The comparison is the current of the kernel's strongest electrode, mA. In the constant
    procedure, some trials have no current.
    """
    threshold_ma, full_ma = _currents_ma(setup)
    train = setup.train([setup.place], setup.pulse_hz)

    def trial(condition: Condition) -> Trial:
        current_ma = condition.comparison
        shown = replace(train, is_blank=True)
        if current_ma:
            shown = replace(train, level=min(1.0, current_ma / full_ma))
        return Trial(
            condition, (shown,), "felt", "did you feel it? y or n", "mA",
            target="y" if current_ma else "n", exact=True,
        )  # fmt: skip

    if setup.procedure == CONSTANT:
        levels = sorted({min(round(threshold_ma * share, 3), full_ma) for share in LEVELS})
        pairs = [(0.0, level_ma) for level_ma in [0.0, *levels]]
        procedure = setup.constant(pairs, two_intervals=False)
    else:
        low, high = (threshold_ma * share for share in _DETECTION_RANGE)
        procedure = adaptive(
            setup.procedure, 1.5 * threshold_ma, _DETECTION_STEP, low, min(high, full_ma), 0.0,
            setup.trials, two_intervals=False, seed=setup.seed,
        )  # fmt: skip
    yield from ask(procedure, trial)


def _currents_ma(setup: Setup) -> tuple[float, float]:
    """Return the threshold and the comfort level of the site, mA."""
    profile, site = setup.profile, setup.place
    return float(profile.threshold_ma[site]), float(profile.full_ma[site])


def discomfort(setup: Setup) -> Trials:
    """Ask when a rising current is strong enough. It rises to the comfort level of the site."""
    slowest_s = _SLOWER * setup.profile.limits.ramp_s
    if setup.train_s is not None and setup.train_s < slowest_s:
        raise ExperimentError(
            f"a current that reaches the comfort level in {setup.train_s:g} s rises too fast: give "
            f"a train_s of {slowest_s:g} s or more"
        )
    train = setup.train([setup.place], setup.pulse_hz)
    setup.total = setup.repetitions or _DISCOMFORTS
    for repetition in range(setup.total):
        yield Trial(
            Condition(0.0, math.nan, repetition=repetition), (train,), "enough",
            "press Enter when the current is strong enough", "mA", exact=True,
            answers={"\n": "y", "\r": "y", "y": "y", "n": "n"},
            course=_rising(train, _currents_ma(setup)[1]),
        )  # fmt: skip


def _rising(train: Train, full_ma: float) -> Course:
    """Raise the current over the duration of a train. Return y at a key press, otherwise n."""
    steps = round(train.seconds / STEP_S)
    pressed: bool | None = None
    while pressed is None:
        for step in range(1, steps + 1):
            pressed = yield full_ma * step / steps
            if pressed or pressed is None:
                break
    return "y" if pressed else "n"


def localization(setup: Setup) -> Trials:
    """Ask whether the second of two points is left or right. The comparison is the offset, mm."""
    site, place_mm = setup.place, setup.profile.electrodes.position_mm
    driven = setup.profile.driven
    beside = {
        round(float(right_mm), 3): int(other)
        for other, (right_mm, down_mm) in zip(driven, place_mm[driven] - place_mm[site],
                                              strict=True)
        if abs(down_mm) < 1e-3 < abs(right_mm)
    }  # fmt: skip
    far_mm = sorted({abs(x_mm) for x_mm in beside if -x_mm in beside})[:_FARTHEST]
    if not far_mm:
        raise ExperimentError(
            f"site {site} does not have neighbors on both sides: choose one in the middle of a row"
        )

    def trial(condition: Condition) -> Trial:
        right_mm = condition.comparison
        points = (site, beside[right_mm])
        return Trial(
            condition, tuple(setup.train([point], setup.pulse_hz) for point in points), "side",
            "was the second point left or right? arrow keys", "mm", answers=LEFT_OR_RIGHT,
            success="r", target="r" if right_mm > 0 else "l",
        )  # fmt: skip

    pairs = [(0.0, sign * distance_mm) for distance_mm in far_mm for sign in (-1, 1)]
    yield from ask(setup.constant(pairs, two_intervals=False), trial)


def softness(setup: Setup) -> Trials:
    """Ask which of two points is softer while the finger moves (paper, Section III-B.2).

    One point feels hard, because its pulse rate follows the finger's force. The comparison is the
    softness of the other point. At softness 1, the pulse rate is constant.
    """
    if setup.afferent is not Afferent.SAI:
        raise ExperimentError("softness is felt through SAI: give --mode SAI")
    setup.notes.append(
        "move the finger up and down in each interval, and give --force: without measured force "
        "all stimuli feel the same"
    )

    def trial(condition: Condition) -> Trial:
        hard = setup.train([setup.place], setup.pulse_hz)
        comparison_train, other = (
            replace(hard, softness=condition.comparison),
            replace(hard, softness=0.0),
        )
        return in_two_intervals(
            condition, comparison_train, other, "softer", "which was softer?", "softness"
        )

    yield from ask(setup.constant([(0.0, softness_level) for softness_level in SOFTNESSES]), trial)


CATALOG = {
    "frequency": Experiment("which train is faster? (paper, III-C)", frequency, ADAPTIVE, 1.0),
    "detection": Experiment(
        "is a pulse train felt? (result: threshold current, mA)", detection, ADAPTIVE
    ),
    "discomfort": Experiment(
        "when is a rising current strong enough? (result: current, mA)", discomfort, (LIMITS,), 10.0
    ),
    "localization": Experiment(
        "is the second point left or right of the first? (result: offset, mm)", localization
    ),
    "softness": Experiment(
        "which point is softer as the finger moves? (paper, III-B)", softness, train_s=3.0
    ),
}  # fmt: skip
"""Experiments of the package, by name."""


def find_experiment(name: str) -> Experiment:
    """Return an experiment from its name in the catalog or from a user's Python file."""
    if name in CATALOG:
        return CATALOG[name]
    if name.endswith(".py"):
        return _experiment_of_file(name)
    raise ExperimentError(
        f"there is no experiment {name!r}: choose {' or '.join(CATALOG)}, or give a file of your "
        "own, as in mine.py"
    )


def _experiment_of_file(name: str) -> Experiment:
    require_file(Path(name), ExperimentError, _MOST_BYTES)
    try:
        module_names = runpy.run_path(name)
    except Exception as error:
        raise _failure(name, error) from error
    experiments = {
        id(value): value for value in module_names.values() if isinstance(value, Experiment)
    }
    if len(experiments) != 1:
        raise ExperimentError(
            f"{name} defines {len(experiments) or 'no'} Experiment{'s' * (len(experiments) > 1)}: "
            "define one, as in experiment = Experiment('its question', trials)"
        )
    return next(iter(experiments.values()))


def trials_of(name: str, setup: Setup) -> tuple[Setup, Trials]:
    """Return the setup with defaults for missing options, and the trials of the experiment."""
    entry = find_experiment(name)
    procedure = setup.procedure or entry.procedures[0]
    if procedure not in entry.procedures:
        choices = " or ".join(entry.procedures)
        raise ExperimentError(
            f"{name} has no procedure {procedure!r}: choose {choices}"
        )  # fmt: skip
    setup = replace(setup, procedure=procedure, train_s=setup.train_s or entry.train_s)
    return setup, entry.trials(setup) if name in CATALOG else _checked(name, entry, setup)


def _checked(name: str, entry: Experiment, setup: Setup) -> Trials:
    """Yield trials of a user's experiment. Errors in the user's code become ExperimentErrors."""
    answer = None
    try:
        trials = entry.trials(setup)
        if not isinstance(trials, Generator):
            raise ExperimentError(
                f"the trials of {name} are a {type(trials).__name__}: give a generator function, "
                "which yields each Trial and receives its Answer"
            )
        while True:
            try:
                trial = next(trials) if answer is None else trials.send(answer)
            except StopIteration:
                return
            if not isinstance(trial, Trial):
                raise ExperimentError(
                    f"{name} yields a {type(trial).__name__}: it must yield a Trial"
                )
            answer = yield trial
    except SmartTouchError:
        raise
    except Exception as error:
        raise _failure(name, error) from error


def _failure(name: str, error: Exception) -> ExperimentError:
    """Return an error that names the line in which the user's code failed."""
    package_path, line = str(Path(__file__).parents[1]), ""
    if isinstance(error, SyntaxError):
        line = f" in line {error.lineno}"
    for frame in traceback.extract_tb(error.__traceback__):
        if not frame.filename.startswith((package_path, "<frozen")):
            line = f" in line {frame.lineno}"
    return ExperimentError(f"{name} fails{line}: {type(error).__name__}: {error}")
