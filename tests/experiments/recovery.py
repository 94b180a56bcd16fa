"""Errors of procedures that look for known thresholds of many simulated subjects."""

from dataclasses import dataclass

import numpy as np

from smarttouch.experiments.answers import usual_model
from smarttouch.experiments.findings import judge_answers
from smarttouch.experiments.procedures import (
    constant_stimuli,
    quest_plus,
    ratio_pairs,
    weighted_staircase,
)

from .simulated import Subject, answer_all

STANDARD = 30.0
LEVELS = 0.5 * 2 ** (np.arange(-4, 5) / 4)
PROCEDURES = ("constant", "staircase", "questplus")
TASKS = ("discrimination", "detection")


@dataclass(frozen=True)
class Recovery:
    """Results of subjects, on average.

    Natural logarithms of estimate over truth,
    subjects without a threshold, trials, and the share of intervals that hold the truth.
    """

    fitted: np.ndarray
    without: int
    trials: float
    covered: float

    @property
    def cells(self):
        cells = {"trials": f"{self.trials:.1f}", "without threshold": self.without}
        error = self.fitted
        cells["bias, SD (n)"] = f"{error.mean():+.3f}, {error.std():.3f} ({len(error)})"
        return cells | {"95 % interval holds": f"{self.covered:.2f}"}


def open_procedure(task, name, seed):
    """Return a procedure as it is used with real subjects."""
    if task == "discrimination":
        if name == "constant":
            return constant_stimuli(ratio_pairs([STANDARD]), seed=seed)
        low, high = 1.01 * STANDARD, 2 * STANDARD
        if name == "staircase":
            return weighted_staircase(1.6 * STANDARD, low, high, 0.03, STANDARD, seed=seed)
        return quest_plus(low, high, 0.5, STANDARD, seed=seed)
    if name == "constant":
        pairs = [(0.0, float(each)) for each in LEVELS]
        return constant_stimuli(pairs, two_intervals=False, seed=seed)
    if name == "staircase":
        return weighted_staircase(1.0, 0.1, 2.0, 0.05, target=0.5, two_intervals=False, seed=seed)
    return quest_plus(0.1, 2.0, 0.0, two_intervals=False, seed=seed)


def draw_subject(task, random):
    """Return a subject: Weber fraction 8 to 40 %, absolute threshold around 0.5, lapses to 5 %."""
    lapse = random.uniform(0, 0.05)
    if task == "discrimination":
        weber = np.exp(random.uniform(np.log(0.08), np.log(0.4)))
        return Subject(STANDARD * (1 + weber), np.log1p(weber) / 0.6745, 0.75, lapse)
    threshold = 0.5 * np.exp(random.normal(0, 0.25))
    return Subject(threshold, random.uniform(0.08, 0.3), 0.5, lapse, guess=0.0)


def recover(task, name, subjects, covering=0, seed=0):
    """Let subjects go through a procedure; of so many, look at the interval, too."""
    random = np.random.default_rng(seed)
    fitted, held, trials = [], [], []
    for index in range(subjects):
        subject = draw_subject(task, random)
        answers = answer_all(open_procedure(task, name, index), subject.probability, [seed, index])
        trials.append(answers.answered)
        found = judge_answers(answers, usual_model([answers]))
        if found.verdict is not None:
            continue
        fitted.append(np.log(found.threshold.value / subject.threshold))
        if index < covering:
            held.append(found.threshold.low <= subject.threshold <= found.threshold.high)
    return Recovery(
        np.array(fitted), subjects - len(fitted), float(np.mean(trials)),
        float(np.mean(held)) if held else np.nan,
    )  # fmt: skip
