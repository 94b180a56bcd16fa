"""QUEST+ shows the most informative stimulus, and finds the threshold."""

import numpy as np
import pytest

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.fitting.psychometric import Model
from smarttouch.experiments.psychophysics.adaptive_procedures import QuestPlus

from ...raising import raises
from .simulated import answer_all


def test_least_expected_entropy():
    """Against the definition: the posterior after each answer, its entropy, their mean."""
    procedure = QuestPlus(10.0, 40.0, Model(guess=0.5))
    random = np.random.default_rng(2)
    for _ in range(12):
        before = procedure._posterior.copy()
        shown = procedure.next().comparison
        expected = []
        for likely in procedure._likely:
            total = 0.0
            for part in (likely, 1 - likely):
                chance = part @ before
                after = part * before / chance if chance > 0 else before
                total -= chance * (after[after > 0] @ np.log(after[after > 0]))
            expected.append(total)
        place = np.argmin(np.abs(procedure.model.stimulus(procedure._places) - shown))
        assert expected[place] == pytest.approx(min(expected), abs=1e-9)
        procedure.answer(bool(random.random() < 0.7))


def test_no_answer_teaches_nothing():
    procedure = QuestPlus(5.0, 80.0, most_trials=3)
    assert procedure.total == 3
    first = procedure.next().comparison
    for _ in range(3):
        assert procedure.next().comparison == first
        procedure.answer(None)
    assert procedure.done
    assert procedure.estimate() is None
    with raises(ExperimentError, names="trial"):
        procedure.next()


def test_a_linear_axis():
    procedure = QuestPlus(-4.0, 4.0, Model(logarithmic=False), most_trials=100, two_intervals=False)
    answers = answer_all(procedure, lambda mm: float(mm > 1.0))
    assert procedure.estimate().threshold == pytest.approx(1.0, abs=0.3)
    assert not answers.interval.any()


@pytest.mark.parametrize(("arguments", "about", "value"), [
    ((2.0, 1.0), "range", (2, 1)),
    ((0.0, 1.0), "range", (0, 1)),
    ((1.0, 2.0, Model(guess="free")), "guess", "guess rate"),
])  # fmt: skip
def test_errors(arguments, about, value):
    with raises(ExperimentError, value=value):
        QuestPlus(*arguments)
