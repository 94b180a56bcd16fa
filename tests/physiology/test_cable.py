"""The cable equation against the heat equation and closed forms."""

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ..reference.cable import cable_response

LENGTH_CONSTANT_MM = 0.4
TIME_CONSTANT_US = 90.0
SPACING_MM = 0.02
PLACES_MM = (np.arange(401) - 200) * SPACING_MM

amplitudes = st.floats(-10, 10)


def respond(activating, waveform, step_us=5.0, **options):
    return cable_response(
        activating, SPACING_MM, LENGTH_CONSTANT_MM, TIME_CONSTANT_US, waveform, step_us, **options
    )


def test_free_decay_is_spreading_heat_times_an_exponential():
    """Appendix A: V = exp(−t/τ) W, where W obeys the heat equation."""
    narrow_mm = 0.3
    start = np.exp(-((PLACES_MM / narrow_mm) ** 2) / 2)
    free = respond(np.zeros_like(start), np.zeros(40), initial_mv=start)
    for step in (0, 9, 39):
        time_us = 5.0 * (step + 1)
        wide_mm = np.sqrt(narrow_mm**2 + 2 * LENGTH_CONSTANT_MM**2 * time_us / TIME_CONSTANT_US)
        heat = narrow_mm / wide_mm * np.exp(-((PLACES_MM / wide_mm) ** 2) / 2)
        expected = np.exp(-time_us / TIME_CONSTANT_US) * heat
        assert free[step] == pytest.approx(expected, rel=2e-3, abs=1e-5)


def test_sealed_ends_keep_the_heat():
    start = np.zeros(30)
    start[0], start[20] = 3.0, 1.0
    free = respond(np.zeros(30), np.zeros(50), initial_mv=start)
    elapsed_us = 5.0 * np.arange(1, 51)
    heat = np.exp(elapsed_us / TIME_CONSTANT_US) * free.sum(axis=1)
    assert heat == pytest.approx(np.full(50, 4.0))


def test_long_pulse_settles_on_the_closed_form_around_a_point():
    drive = np.zeros_like(PLACES_MM)
    drive[200] = 1 / SPACING_MM
    settled = respond(drive, np.ones(1), step_us=30 * TIME_CONSTANT_US)[-1]
    expected = LENGTH_CONSTANT_MM / 2 * np.exp(-np.abs(PLACES_MM) / LENGTH_CONSTANT_MM)
    assert settled == pytest.approx(expected, rel=6e-3, abs=1e-5)


def test_an_independent_integrator_agrees():
    drive = np.random.default_rng(5).normal(size=15)
    diffusion = (LENGTH_CONSTANT_MM / SPACING_MM) ** 2 / TIME_CONSTANT_US

    def slope(_, v):
        spread = np.diff(v, prepend=v[0], append=v[-1])
        return diffusion * np.diff(spread) + (LENGTH_CONSTANT_MM**2 * drive - v) / TIME_CONSTANT_US

    checked = solve_ivp(slope, (0, 40), np.zeros(15), method="LSODA", rtol=1e-9, atol=1e-12)
    assert respond(drive, np.ones(8))[-1] == pytest.approx(checked.y[:, -1], rel=1e-5, abs=1e-8)
