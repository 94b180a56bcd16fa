"""Psychometric functions: shapes, where their thresholds are, and their fits."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import differential_evolution
from scipy.stats import chi2

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.fitting.answers import Counts
from smarttouch.experiments.fitting.fit import credible_interval, fit
from smarttouch.experiments.fitting.psychometric import Model, Parameters, Shape, log_likelihood

from ...raising import raises
from ..psychophysics.simulated import Subject

MODELS = [
    Model(), Model(Shape.LOGISTIC), Model(Shape.WEIBULL, guess=0.5), Model(guess=0.0, at=0.75),
    Model(guess="free"), Model(Shape.LOGISTIC, logarithmic=False, guess=0.04),
]  # fmt: skip


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
def test_any_data_give_a_rising_function_between_0_and_1(counts, model):
    found = fit(counts, model)
    shares = found(np.linspace(counts.stimulus[0] / 3, 3 * counts.stimulus[-1], 200))
    assert ((shares >= 0) & (shares <= 1)).all()
    assert (np.diff(shares) >= -1e-12).all()
    assert 0 <= found.lapse <= model.most_lapses
    assert math.isfinite(found.threshold)
    assert found.deviance >= -1e-6


@given(data(), st.sampled_from([1e-3, 0.3, 250.0]))
def test_unit_is_of_no_account_on_a_logarithmic_axis(counts, factor):
    one = fit(counts, Model())
    other = fit(counts._replace(stimulus=counts.stimulus * factor), Model())
    assert other.log_likelihood == pytest.approx(one.log_likelihood, abs=1e-5)
    x = counts.stimulus
    assert other(x * factor) == pytest.approx(one(x), abs=2e-3)


def test_two_points_by_hand():
    """Logits of 1/4 and 3/4 are -+ ln 3: the middle lies between, the scale is 1 / ln 3."""
    model = Model(Shape.LOGISTIC, logarithmic=False, guess=0.0, most_lapses=0.0)
    found = fit(counts_of([0, 2], [20, 20], [5, 15]), model)
    assert found.threshold == pytest.approx(1.0, abs=1e-6)
    assert found.spread == pytest.approx(1 / math.log(3), abs=1e-5)
    assert found.slope == pytest.approx(math.log(3) / 4, abs=1e-5)
    assert found(np.array([0.0, 1.0, 2.0])) == pytest.approx([0.25, 0.5, 0.75], abs=1e-6)
    assert found.deviance == pytest.approx(0, abs=1e-8)
    assert found.at(0.75) == pytest.approx(2.0, abs=1e-5)


def test_deviance_by_hand():
    """A curve that can only be flat at a half, against 8 of 10 twice: 4 (8 ln 1.6 + 2 ln 0.4)."""
    model = Model(guess=0.5, logarithmic=False, most_lapses=0.1)
    found = fit(counts_of([1, 2], [10, 10], [8, 2]), model)
    whole = 2 * (8 * math.log(0.8) + 2 * math.log(0.2))
    assert found.deviance == pytest.approx(2 * (whole - found.log_likelihood))
    assert found.log_likelihood == pytest.approx(20 * math.log(0.5), abs=0.01)


@pytest.mark.parametrize("shape", Shape)
def test_shapes(shape):
    z = np.linspace(-4, 4, 801)
    part, slope = shape.rises(z)
    assert part[400] == pytest.approx(0.5)
    assert np.gradient(part, z)[1:-1] == pytest.approx(slope[1:-1], abs=1e-4)
    for each in (0.1, 0.5, 0.9):
        assert shape.rises(np.array([shape.inverse(each)]))[0] == pytest.approx(each)


def test_weibull_is_weibull():
    """1 - exp(-(x / scale)^power), put through its median."""
    scale, power = 3.0, 2.5
    median = scale * math.log(2) ** (1 / power)
    parameters = parameters_of(math.log(median), -math.log(power), 0.0, 0.0)
    x = np.array([0.5, 2.0, 3.0, 5.0])
    model = Model(Shape.WEIBULL, guess=0.0)
    likely = model.probability(model.axis(x), parameters)[0]
    assert likely == pytest.approx(1 - np.exp(-((x / scale) ** power)))


@settings(deadline=None)
@given(
    st.sampled_from(MODELS), st.floats(-1, 1), st.floats(-2, 1), st.floats(0, 0.1),
    st.floats(0, 0.4),
)  # fmt: skip
def test_slopes_are_derivatives(model, threshold, log_spread, lapse, guess):
    guess = lapse if model.guess == "equal" else guess
    at = np.array([threshold, log_spread, lapse, guess])
    x = np.linspace(-2, 2, 7)

    def likely(values):
        values = values.copy()
        values[3] = values[2] if model.guess == "equal" else values[3]
        return model.probability(x, Parameters(*values[:, None]))[0]

    _, slopes = model.slopes(x, Parameters(*at[:, None]))
    for index in range(3 if model.guess == "equal" else 4):
        step = np.zeros(4)
        step[index] = 1e-6
        numeric = (likely(at + step) - likely(at - step)) / 2e-6
        assert slopes[0, index] == pytest.approx(numeric, abs=1e-5)


@pytest.mark.parametrize("model", MODELS)
def test_the_threshold_is_at_the_stated_share(model):
    parameters = parameters_of(0.7, -0.5, 0.0, 0.0)
    if not isinstance(model.guess, str):
        parameters = parameters._replace(guess=np.array([model.guess]))
    share = model.probability(np.array([0.7]), parameters)[0, 0]
    assert share == pytest.approx(model.share)
    assert model.place(model.level, parameters)[0] == pytest.approx(0.7)
    assert Model().share == 0.75
    assert Model(guess=0.5).share == 0.75
    assert Model(guess=0.0).share == 0.5


def test_nothing_at_all_is_guessed():
    model = Model(guess="free")
    x = model.axis([0.0, 1.0])
    parameters = parameters_of(0.0, 0.0, 0.02, 0.13)
    likely, slopes = model.slopes(x, parameters)
    assert likely[0, 0] == 0.13
    assert slopes[0, :, 0].tolist() == [0, 0, 0, 1]
    counts = counts_of([0, 1, 2, 4, 8], [40] * 5, [8, 8, 22, 38, 40])
    assert fit(counts, model).guess == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("model", [Model(), Model(guess=0.5), Model(Shape.LOGISTIC, guess="free")])
def test_no_other_function_is_more_likely(model):
    """Against scipy's search by differential evolution, which needs neither start nor slope."""
    random = np.random.default_rng(3)
    stimulus = 30 * 2 ** (np.arange(-9, 10, 2) / 9)
    x, n = np.log(stimulus), np.full(10, 10.0)
    k = random.binomial(10, Subject(35.0, 0.3, lapse=0.02).probability(stimulus)).astype(float)

    def lost(values):
        guess = {"equal": values[2], "free": values[3]}.get(model.guess, model.guess)
        shares = model.probability(x, Parameters(*np.reshape([*values[:3], guess], (4, 1))))
        return -log_likelihood(shares[0], n, k)

    bounds = [(x[0], x[-1]), (-4, 2), (0, model.most_lapses), (0, 0.5)]
    other = differential_evolution(lost, bounds, seed=1, tol=1e-8)
    assert fit(Counts(stimulus, n, k), model).log_likelihood >= -other.fun - 1e-5


def test_intervals_shrink_with_trials():
    stimulus = 30 * 2 ** (np.arange(-9, 10, 2) / 9)
    share = Subject(36.0, 0.25).probability(stimulus)
    few, many = (
        fit(counts_of(stimulus, np.full(10, n), np.round(n * share)), Model()).bounded(0.75)
        for n in (10, 160)
    )
    assert few.low < few.value < few.high
    # Sixteen times the trials, a quarter of the interval.
    assert 3 < (few.high - few.low) / (many.high - many.low) < 5.5


def test_an_interval_without_an_end():
    counts = counts_of([20, 25, 30, 40, 50], [3] * 5, [0, 1, 1, 1, 2])
    low, high = credible_interval(Model(), counts, 0.75, 0.95)
    assert low < math.log(50)
    assert math.isinf(high)


def test_goodness():
    stimulus = np.geomspace(15, 60, 10)
    share = Subject(36.0, 0.25).probability(stimulus)
    good = counts_of(stimulus, np.full(10, 20), np.round(20 * share))
    assert fit(good, Model()).goodness > 0.2
    odd = np.where(np.arange(10) % 2, np.minimum(20, 20 * share + 9), np.maximum(0, 20 * share - 9))
    poor = fit(counts_of(stimulus, np.full(10, 20), np.round(odd)), Model())
    assert poor.goodness == pytest.approx(chi2.sf(poor.deviance, 7))
    assert poor.goodness < 0.01
    each = np.geomspace(15, 60, 60)
    said = np.random.default_rng(1).random(60) < Subject(36.0, 0.5).probability(each)
    single = fit(counts_of(each, np.ones(60), said), Model())
    assert single.goodness is None
    assert not single.sudden


@pytest.mark.parametrize(("arguments", "about", "value"), [
    ({"shape": Shape.WEIBULL, "logarithmic": False}, "shape", "Weibull"),
    ({"guess": 1.0}, "guess", 1.0),
    ({"guess": -0.1}, "guess", -0.1),
    ({"guess": 0.5, "at": 0.4}, "at", 0.4),
    ({"at": 1.0}, "at", 1.0),
    ({"most_lapses": 0.5}, "most_lapses", 0.5),
])  # fmt: skip
def test_contradictions(arguments, about, value):
    with raises(ExperimentError, value=value):
        replace(Model(), **arguments)


def test_negative_stimuli_need_a_linear_axis():
    with raises(ExperimentError, value=-1.0):
        Model().axis([-1.0])
