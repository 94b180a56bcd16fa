"""Psychophysical procedures: generators of conditions that receive the answer to each trial.

An answer is True for a success (judged higher, felt or correct), False for a failure, and None if
it is missing. Procedures are deterministic, so sending the same answers again resumes a session.
"""

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychometric import Array, Model, Parameters


@dataclass(frozen=True)
class Condition:
    """Stimulus of one trial."""

    standard: float  # standard; 0 if there is none
    comparison: float  # NaN if the keys of the participant determine it
    # interval with the comparison, 1 or 2; 0 if there is a single interval
    comparison_interval: int = 0
    repetition: int = 0  # number of the repetition (thisRepN in PsychoPy)
    index: int = 0  # number of the condition (thisIndex in PsychoPy)
    trial: int = 0  # number of the trial in the repetition (thisTrialN in PsychoPy)


Procedure = Generator[Condition, bool | None, None]

CONSTANT, STAIRCASE, QUESTPLUS, LIMITS = "constant", "staircase", "questplus", "limits"
ADAPTIVE = (CONSTANT, STAIRCASE, QUESTPLUS)


def interleave(procedures: Sequence[Procedure], seed: int = 0) -> Procedure:
    """Interleave the trials of several procedures at random."""
    random = np.random.default_rng([seed, len(procedures)])
    waiting = {index: next(procedure) for index, procedure in enumerate(procedures)}
    while waiting:
        index = int(random.choice(list(waiting)))
        success = yield replace(waiting[index], index=index)
        try:
            waiting[index] = procedures[index].send(success)
        except StopIteration:
            del waiting[index]


def middle_and_spread(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Return the median and a robust standard deviation: 1.4826 times the median absolute
    deviation."""
    middle = float(np.median(values))
    return middle, 1.4826 * float(np.median(np.abs(np.asarray(values) - middle)))


STANDARDS_HZ = (15.0, 30.0, 45.0, 60.0, 75.0)
"""Standards of the paper's frequency discrimination (Section III.C)."""
WIDEST_RATIO = 2.0  # comparisons are 0.5 to 2 times the standard (Section III.C)
RATIOS = tuple(WIDEST_RATIO ** (step / 9) for step in range(-9, 10, 2))
"""Ten ratios from 1/2 to 2, in equal logarithmic steps. The ratio 1 is left out, because neither
answer would be correct."""
REPETITIONS = 10  # trials of each pair of standard and comparison (Section III.C)


def ratio_pairs(
    # Each comparison is a standard times a ratio.
    standards: Sequence[float] = STANDARDS_HZ,
    ratios: Sequence[float] = RATIOS,
    highest: float = math.inf,  # largest allowed standard or comparison
) -> list[tuple[float, float]]:
    """Return pairs of standard and comparison. Comparisons are rounded to 0.001."""
    pairs = [
        (float(standard), round(standard * ratio, 3))
        for standard in standards
        for ratio in ratios
        if max(standard, standard * ratio) <= highest
    ]
    if not pairs:
        raise ExperimentError(
            f"all pairs of standard and comparison exceed {highest:g}: give lower standards"
        )
    return pairs


def constant_stimuli(
    # (standard, comparison); the standard is 0 if there is none
    pairs: Sequence[tuple[float, float]],
    repetitions: int = REPETITIONS,  # trials of each pair
    two_intervals: bool = True,  # whether a second interval presents the standard
    seed: int = 0,  # seed of the random orders
) -> Procedure:
    """Present each pair a fixed number of times, in a new random order for each repetition.

    With two intervals, half of the trials of each pair present the comparison first. A trial
    without an answer is repeated once, at the end.
    """
    if not pairs or repetitions < 1:
        raise ExperimentError(
            f"{len(pairs)} conditions and {repetitions} repetitions are not enough: give at "
            "least one of each"
        )
    random = np.random.default_rng([seed, len(pairs), repetitions])
    # If `repetitions` is odd, half of the pairs have one more trial with the comparison first. The
    # other pairs have one more trial with the comparison second.
    balanced = (np.arange(repetitions) + np.arange(len(pairs))[:, None]) % 2 + 1
    interval = random.permuted(balanced, axis=1) * two_intervals
    plan = [
        Condition(
            float(pairs[index][0]), float(pairs[index][1]), int(interval[index, repetition]),
            repetition, int(index), trial,
        )
        for repetition in range(repetitions)
        for trial, index in enumerate(random.permutation(len(pairs)))
    ]  # fmt: skip

    def trials() -> Procedure:
        missed = []
        for condition in plan:
            if (yield condition) is None:
                missed.append(condition)
        for condition in missed:
            yield condition

    return trials()


def _intervals(two_intervals: bool, seed: int) -> Iterator[int]:
    """Yield the comparison's interval: 1 or 2 in balanced random order; 0 with one interval."""
    random = np.random.default_rng([seed, 2])
    while True:
        block = [int(interval) for interval in random.permutation([1] * 4 + [2] * 4)][::-1]
        yield from block if two_intervals else [0]


_COARSE_FACTOR, _COARSE_REVERSALS = 2.0, 2  # our choice
"""Until reversal `_COARSE_REVERSALS`, steps of a staircase are `_COARSE_FACTOR` times as large."""
_REVERSALS = 14  # number of reversals that ends a staircase
_PINNED_TRIALS = 4
"""A staircase stops after this number of successive steps that would leave the range."""


def weighted_staircase(
    start: float,  # first comparison, above 0
    lowest: float,  # smallest comparison, above 0
    highest: float,  # largest comparison
    step: float,  # step down, relative to the comparison; first steps are larger
    standard: float = 0.0,  # standard; 0 if there is none
    target: float = 0.75,  # share of successes at which the staircase converges
    most_trials: int = 80,
    two_intervals: bool = True,  # whether a second interval presents the standard
    seed: int = 0,  # seed of the order of intervals
) -> Procedure:
    """Lower the comparison after a success, and raise it after a failure.

    Steps up are target / (1 - target) times as large as steps down. The staircase then converges
    where the share of successes equals the target (Kaernbach, Perception & Psychophysics 49, 1991,
    Eq. 1). A trial without an answer is repeated, and counts toward ``most_trials``.
    """
    intervals = _intervals(two_intervals, seed)

    def trials() -> Procedure:
        level, low, high = math.log(start), math.log(lowest), math.log(highest)
        turns, pinned, rising = 0, 0, None
        interval = next(intervals)
        for trial in range(most_trials):
            success = yield Condition(standard, math.exp(level), interval, trial)
            if success is None:
                continue
            interval = next(intervals)
            turns += rising is not None and rising == success
            rising = not success
            down = math.log1p(step) * (_COARSE_FACTOR if turns < _COARSE_REVERSALS else 1)
            wanted = level - down if success else level + down * target / (1 - target)
            pinned = pinned + 1 if wanted < low or wanted > high else 0
            level = min(max(wanted, low), high)
            if turns >= _REVERSALS or pinned >= _PINNED_TRIALS:
                return

    return trials()


_STIMULI, _THRESHOLDS, _SLOPES = 41, 61, 9
_LAPSES = (0.0, 0.02, 0.05, 0.1)
"""Lapse rates on the grid, with equal prior probabilities (our own choice)."""
_NARROWEST, _WIDEST = 1 / 40, 1.0  # smallest and largest spread, relative to the range of stimuli


def quest_plus(
    lowest: float,  # smallest stimulus, and smallest possible threshold
    highest: float,  # largest stimulus, and largest possible threshold
    guess: float = 0.5,  # share of successes by guessing
    standard: float = 0.0,  # standard; 0 if there is none
    most_trials: int = 60,
    two_intervals: bool = True,  # whether a second interval presents the standard
    seed: int = 0,  # seed of the order of intervals
) -> Procedure:
    """Present the stimulus whose answer has the largest expected information (QUEST+, Watson,
    Journal of Vision 17(3):10, 2017). The parameters are threshold, slope and lapse rate.

    The expected information is the entropy of the answer, minus the mean entropy of the answer if
    the parameters were known. A trial without an answer counts toward ``most_trials``.
    """
    low, high = math.log(lowest), math.log(highest)
    places = np.linspace(low, high, _STIMULI)
    spreads = (high - low) * np.geomspace(_NARROWEST, _WIDEST, _SLOPES)
    axes = np.linspace(low, high, _THRESHOLDS), spreads, _LAPSES
    middle, spread, lapse = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    functions = Parameters(middle, spread, lapse, np.full_like(lapse, guess))
    likely = Model(guess=guess).probability(places, functions).T
    intervals = _intervals(two_intervals, seed)

    def trials() -> Procedure:
        unsure = _entropy(likely)
        posterior = np.full(len(middle), 1 / len(middle))
        for trial in range(most_trials):
            chosen = int((_entropy(likely @ posterior) - unsure @ posterior).argmax())
            success = yield Condition(standard, math.exp(places[chosen]), next(intervals), trial)
            if success is not None:
                posterior = posterior * (likely[chosen] if success else 1 - likely[chosen])
                posterior /= posterior.sum()

    return trials()


def _entropy(likely: Array) -> Array:
    """Return the entropy of an answer, in nats, from the probability of a success."""
    likely = np.clip(likely, 1e-12, 1 - 1e-12)
    return np.asarray(-(likely * np.log(likely) + (1 - likely) * np.log1p(-likely)))


def adaptive(
    method: str,  # STAIRCASE or QUESTPLUS
    start: float,  # first comparison of a staircase
    step: float,  # step down of a staircase, relative to the comparison
    lowest: float,  # smallest stimulus
    highest: float,  # largest stimulus
    standard: float = 0.0,
    trials: int | None = None,
    two_intervals: bool = True,
    seed: int = 0,
) -> Procedure:
    """Return a staircase or QUEST+ over a range of stimuli."""
    if method == STAIRCASE:
        return weighted_staircase(
            min(start, highest), lowest, highest, step, standard, most_trials=trials or 80,
            two_intervals=two_intervals, seed=seed,
        )  # fmt: skip
    guess = 0.5 if two_intervals else 0.0
    return quest_plus(lowest, highest, guess, standard, trials or 60, two_intervals, seed)
