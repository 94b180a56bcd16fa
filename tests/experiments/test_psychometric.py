"""Psychometric functions: where their thresholds are, and the posterior of answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychometric import Counts, Model, Parameters, fit

from ..support.checks import raises
from .simulated import Subject

MODELS = [
    Model(), Model(guess=0.5), Model(guess=0.0, at=0.75), Model(guess="free"),
    Model(guess=0.04, logarithmic=False),
]  # fmt: skip
STIMULUS = 30 * 2 ** (np.arange(-9, 10, 2) / 9)


def parameters_of(*values):
    return Parameters(*(np.array([each]) for each in values))


def counts_of(stimulus, n, k):
    return Counts(*(np.asarray(each, float) for each in (stimulus, n, k)))


@st.composite
def data(draw):
    stimulus = draw(st.lists(st.integers(1, 400), min_size=2, max_size=9, unique=True).map(sorted))
    n = [draw(st.integers(1, 30)) for _ in stimulus]
    return counts_of(stimulus, n, [draw(st.integers(0, each)) for each in n])


@given(data(), st.sampled_from(MODELS))
def test_any_answers_give_estimates_in_their_intervals_that_rise_with_the_share(counts, model):
    found = fit(counts, model)
    shares = found(np.linspace(counts.stimulus[0] / 3, 3 * counts.stimulus[-1], 50))
    assert ((shares >= 0) & (shares <= 1)).all()
    assert (np.diff(shares) >= -1e-12).all()
    bounded = np.array([found.bounded(part) for part in (0.1, 0.5, 0.75, 0.9)])
    assert (bounded[1:] >= bounded[:-1]).all()
    value, low, high = bounded.T
    assert ((low <= value) & (value <= high) & np.isfinite(value)).all()


@given(data(), st.sampled_from([1e-3, 0.3, 250.0]))
def test_unit_is_of_no_account_on_a_logarithmic_axis(counts, factor):
    one = fit(counts, Model())
    other = fit(counts._replace(stimulus=counts.stimulus * factor), Model())
    assert other.bounded(0.5).value == pytest.approx(factor * one.bounded(0.5).value, rel=1e-6)
    assert other(counts.stimulus * factor) == pytest.approx(one(counts.stimulus), abs=1e-6)


def test_two_points_by_hand():
    """Quantiles of 1/4 and 3/4 are -+ z: the middle lies between, the spread is 1 / z."""
    z = norm.ppf(0.75)
    model = Model(guess=0.0, logarithmic=False, most_lapses=0.0)
    found = fit(counts_of([0, 2], [2000, 2000], [500, 1500]), model)
    assert found.bounded(0.5).value == pytest.approx(1.0, abs=0.01)
    assert found.parameters.spread[0] == pytest.approx(1 / z, rel=0.01)
    assert found.bounded(0.75).value == pytest.approx(2.0, abs=0.02)
    assert found(np.array([0.0, 1.0, 2.0])) == pytest.approx([0.25, 0.5, 0.75], abs=0.01)
    # The deviation of such a quantile, and that of the middle from the mean of two.
    deviation = math.sqrt(0.25 * 0.75 / 2000) / norm.pdf(z) / math.sqrt(2) / z
    half = (found.bounded(0.5).high - found.bounded(0.5).low) / 2
    assert half == pytest.approx(1.96 * deviation, rel=0.05)


@pytest.mark.parametrize("model", MODELS)
def test_the_threshold_is_at_the_stated_share(model):
    parameters = parameters_of(0.7, 0.6, 0.0, 0.0)
    if not isinstance(model.guess, str):
        parameters = parameters._replace(guess=np.array([model.guess]))
    place = model.place(model.level, parameters)
    assert model.probability(place, parameters)[0, 0] == pytest.approx(model.share)
    assert Model().share == Model(guess=0.5).share == 0.75
    assert Model(guess=0.0).share == 0.5


def test_what_nothing_at_all_says_is_the_guess():
    model = Model(guess="free")
    x = model.axis([0.0, 1.0])
    assert model.probability(x, parameters_of(0.0, 1.0, 0.02, 0.13))[0, 0] == 0.13
    counts = counts_of([0, 1, 2, 4, 8], [40] * 5, [8, 8, 22, 38, 40])
    assert fit(counts, model).parameters.guess[0] == pytest.approx(0.2, abs=0.04)


def test_intervals_shrink_with_trials():
    share = Subject(36.0, 0.25).probability(STIMULUS)
    few, many = (
        fit(counts_of(STIMULUS, np.full(10, n), np.round(n * share)), Model()).bounded(0.75)
        for n in (10, 160)
    )
    # Sixteen times the trials, a quarter of the interval.
    assert 3 < (few.high - few.low) / (many.high - many.low) < 5.5


def test_an_interval_without_an_end():
    counts = counts_of([20, 25, 30, 40, 50], [3] * 5, [0, 1, 1, 1, 2])
    found = fit(counts, Model()).bounded(0.99)
    assert found.low < found.value < math.inf
    assert math.isinf(found.high)


@pytest.mark.parametrize(("arguments", "value"), [
    ({"guess": 1.0}, 1.0),
    ({"guess": -0.1}, -0.1),
    ({"guess": 0.5, "at": 0.4}, 0.4),
    ({"at": 1.0}, 1.0),
    ({"guess": 0.5, "most_lapses": 0.3}, 0.5),
])  # fmt: skip
def test_contradictions(arguments, value):
    with raises(ExperimentError, value=value):
        replace(Model(), **arguments)


def test_negative_stimuli_need_a_linear_axis():
    with raises(ExperimentError, value=-1.0):
        Model().axis([-1.0])
