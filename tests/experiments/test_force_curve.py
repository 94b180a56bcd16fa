"""A load cell's curve is found, and readings of anything else are refused."""

import dataclasses

import numpy as np
import pytest

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.force_curve import STANDARD_GRAVITY, fit_curve, weigh

from ..support.checks import raises
from ..support.full import WHOLE
from .simulated_sensors import SimulatedCell

UP_AND_DOWN = (0, 20, 50, 75, 100, 75, 50, 20, 0)
UP = (0, 20, 50, 75, 100)


def weighed(cell, grams=UP, seconds=2.0):
    found = []
    for each in grams:
        cell.put(each)
        found.append(weigh(cell, each, seconds))
    return found


def off_n(cell, found):
    """Return the errors of the curve from 0 to full force."""
    force_n = np.linspace(0, found.full_n, 40)
    seen = cell.zero + cell.counts_per_n * force_n
    return np.array([found.force_n(each) for each in seen]) - force_n


def test_cells_of_known_truth(profile):
    """Noise of 4 mN, 3 % garbage, 2 % NaN: bias and spread over the whole range."""
    off = []
    for seed in range(200 if WHOLE else 50):
        random = np.random.default_rng(seed)
        cell = SimulatedCell(
            counts_per_n=random.choice([-1, 1]) * 10 ** random.uniform(3, 6),
            zero=random.uniform(-1e5, 1e5), noise_n=0.004, garbage=0.03, missing=0.02, seed=seed,
        )  # fmt: skip
        off.append(off_n(cell, fit_curve(weighed(cell), profile.force)))
    assert np.abs(np.mean(off, axis=0)).max() < 0.0005
    assert np.std(off, axis=0).max() < 0.001


def test_the_sentence_has_the_results(profile):
    cell = SimulatedCell(counts_per_n=-2e5, zero=5000, hysteresis_n=0.02, noise_n=0.003)
    found = fit_curve(weighed(cell, UP_AND_DOWN), profile.force)
    assert found.slope_n == pytest.approx(-1 / 2e5, rel=0.02)
    assert found.zero == pytest.approx(5000, abs=0.01 * 2e5)
    assert 0.003 < found.residual_n < np.abs(found.off_n).max() < 0.02
    said = found.sentence()
    assert all(each in said for each in ("9", "0 to 100 g", f"{found.residual_n:.4f} N"))


def test_the_curve_keeps_its_digits(profile):
    """Readings of 24 bits: rounding the coefficients must not move the force."""
    cell = SimulatedCell(counts_per_n=8e6, zero=8e6, noise_n=0.0005)
    assert np.abs(off_n(cell, fit_curve(weighed(cell), profile.force))).max() < 0.002


class Listed:
    def __init__(self, readings):
        self._readings = readings

    def collect(self, seconds):
        return np.array(self._readings, float)


@pytest.mark.parametrize("readings", [[], [1, 2], [np.nan] * 9, [1, 2, 3, 4, 5] + [np.nan] * 6])
def test_readings_that_are_none(readings):
    count = np.isfinite(readings).sum()
    with raises(CalibrationError, value=count, allowed=5):
        weigh(Listed(readings), 20, 1.0)


def test_a_weighing_is_robust():
    good = 1000 + np.random.default_rng(0).standard_normal(40)
    found = weigh(Listed([*good, 9e9, -9e9, np.inf, np.nan]), 20, 1.0)
    assert found.reading == pytest.approx(1000, abs=0.5)
    assert found.spread == pytest.approx(1, abs=0.4)
    assert found.count == 42
    assert found.force_n == pytest.approx(0.02 * STANDARD_GRAVITY)


def nonsense():
    """Each a name, weights, readings, and what is wrong with them."""
    line = {0: 0, 20: 2e4, 50: 5e4, 100: 1e5}
    yield "nothing moves", UP, lambda g: 5.0, {"value": 0, "allowed": 0}
    noisy = {"value": 0, "allowed": lambda noise: noise > 15}
    yield "only noise", UP, lambda g: 0.0, noisy
    yield "turns back", (0, 20, 50, 100), {**line, 50: 1e4}.get, {}
    bent = {"value": lambda residual_n: residual_n > 0.05 * 0.9}
    yield "one step", (0, 20, 50, 100), {**line, 50: 2.1e4}.get, bent
    yield "two weights", (0, 0, 100), line.get, {"value": 2}
    yield "too light", (0, 5, 10), lambda g: 1e3 * g, {"value": 10}


@pytest.mark.parametrize(("name", "grams", "reading", "attributes"), list(nonsense()))
def test_nonsense_is_one_sentence(profile, name, grams, reading, attributes):
    noise = np.random.default_rng(0).standard_normal(50) * (30 if name == "only noise" else 0)
    found = [weigh(Listed(reading(each) + noise), each, 1.0) for each in grams]
    with raises(CalibrationError, **attributes):
        fit_curve(found, profile.force)


def test_a_weight_that_was_not_at_rest(profile):
    found = weighed(SimulatedCell())
    found[2] = dataclasses.replace(found[2], drift=0.1 * 4.1e5)
    with raises(CalibrationError, names="drift", value=pytest.approx(0.1, abs=0.001)) as caught:
        fit_curve(found, profile.force)
    assert "50 g" in str(caught.value)
