"""Subjects whose psychometric function is known."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from smarttouch.experiments.answers import Answers


@dataclass(frozen=True)
class Subject:
    """Judges by a cumulative normal of the logarithm of the comparison.

    `threshold` is where it says so `level` of the times, apart from guesses and lapses.
    """

    threshold: float
    spread: float
    level: float = 0.75
    lapse: float = 0.0
    guess: float | None = None

    def probability(self, comparison):
        # The quantile of 0.75 and of 0.5, the only ones in use.
        offset = {0.75: 0.6744897501960817, 0.5: 0.0}[self.level]
        with np.errstate(divide="ignore"):
            z = (np.log(comparison) - np.log(self.threshold)) / self.spread + offset
        guess = self.lapse if self.guess is None else self.guess
        return guess + (1 - guess - self.lapse) * ndtr(z)


def answer_all(procedure, probability, seed=0):
    """Go through a procedure; answers are drawn from the probability of each comparison."""
    random = np.random.default_rng(seed)
    success = []
    shown = ask_all(
        procedure,
        lambda each: (
            success.append(bool(random.random() < probability(each.comparison))) or success[-1]
        ),
    )
    return as_answers(shown, success)


def ask_all(procedure, answer=lambda _condition: True):
    """Return all conditions of a procedure; a function of each gives its answer."""
    shown = []
    condition = next(procedure, None)
    while condition is not None:
        shown.append(condition)
        try:
            condition = procedure.send(answer(condition))
        except StopIteration:
            break
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
    """Return the answers that have these counts."""
    comparison = np.repeat(np.asarray(stimulus, float), n)
    success = np.concatenate(
        [[1.0] * yes + [0.0] * (all_ - yes) for all_, yes in zip(n, k, strict=True)]
    )
    nothing = np.zeros(len(success), np.int64)
    return Answers(standard, comparison, success, nothing, alternatives)
