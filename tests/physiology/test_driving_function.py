"""Driving functions: linear, symmetric, and right where cable models were not fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import DesignError
from smarttouch.physiology.driving_function import FIBERS, load_driving, passes
from smarttouch.physiology.membrane import threshold_ma
from smarttouch.physiology.potential import disc_potential

from ..fit_fibers import fiber_fit
from ..support.checks import raises
from ..support.full import sample

OFFERED = [
    ("fingertip", "through"), ("fingertip", "active"), ("fingertip", "passive"),
    ("trunk", "through"), ("trunk", "active"), ("mrg", "through"), ("mrg", "active"),
]  # fmt: skip


def under_a_disc(fiber, depth_mm, beside_mm=0.0, reach_mm=6.0):
    """Potential per mA along a fiber, flat or rising to its ending, under a cathode."""
    nodes = int(reach_mm / fiber.internode_mm)
    if fiber.end == "through":
        along = np.arange(-nodes, nodes + 1) * fiber.internode_mm
        r, depth = np.hypot(along, beside_mm), np.full(along.shape, depth_mm)
    else:
        depth = depth_mm + np.arange(nodes + 1) * fiber.internode_mm
        r = np.full(depth.shape, beside_mm)
    return -1000 / (2 * np.pi * 0.43) * disc_potential(r, depth, 0.5)


@pytest.mark.parametrize(("fiber", "end"), OFFERED)
@pytest.mark.parametrize("width_us", [50.0, 200.0])
def test_potentials_add_up_and_a_constant_counts_for_nothing(fiber, end, width_us):
    driving = load_driving(fiber, end, width_us)
    one, other = np.random.default_rng(1).normal(size=(2, 1, 60, 1))
    sums = driving.drive(2 * one - 3 * other)
    assert sums == pytest.approx(2 * driving.drive(one) - 3 * driving.drive(other), abs=1e-9)
    assert driving.drive(one + 7) == pytest.approx(driving.drive(one), abs=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_a_fiber_that_runs_through_has_no_direction(seed):
    driving = load_driving("fingertip", "through", 200.0)
    potential = np.random.default_rng(seed).normal(size=(1, 50, 1))
    forth, back = driving.drive(potential), driving.drive(potential[:, ::-1])
    assert forth[:, ::-1] == pytest.approx(back, abs=1e-9)


@pytest.mark.parametrize(("fiber", "end"), [each for each in OFFERED if each[0] != "mrg"])
@pytest.mark.parametrize("width_us", sample([150.0, 100.0, 200.0], 3))
def test_thresholds_of_the_cable_under_a_disc(fiber, end, width_us):
    """Places, and a width, that no fit has seen."""
    like = replace(FIBERS[fiber], end=end)
    potentials = np.array(
        [s * under_a_disc(like, d, b) for d in (0.6, 1.1, 1.8) for b in (0.2, 0.7) for s in (1, -1)]
    )
    drive = load_driving(fiber, end, width_us).drive(potentials[..., None])[..., 0].max(axis=1)
    cable = fiber_fit.thresholds_ma(potentials, like, width_us)
    assert np.isfinite(cable).all()
    error = fiber_fit.threshold_error(drive, cable)
    assert error.median < 0.04
    assert error.worst < 0.35


def test_a_bare_terminal_prefers_the_anode_as_much_as_was_measured():
    """Kaczmarek 2000: cathodic over anodic thresholds of macaque RA afferents, 1.3 to 1.5."""
    like = replace(FIBERS["fingertip"], end="passive")
    potential = under_a_disc(like, 0.7)
    cathodic, anodic = (threshold_ma(potential, like, cathodic=each) for each in (True, False))
    assert 1.3 < cathodic / anodic < 1.5
    drive = load_driving("fingertip", "passive", 200.0).drive(
        np.array([potential, -potential])[..., None]
    )
    by_drive = drive.max(axis=(1, 2))
    assert 1 / by_drive == pytest.approx([cathodic, anodic], rel=0.05)


def test_a_fit_finds_the_weights_again():
    """Thresholds made of a driving function give that driving function back."""
    true = load_driving("trunk", "through", 200.0)
    random = np.random.default_rng(2)
    like = replace(FIBERS["trunk"], end="through")
    basis = np.array([under_a_disc(like, d, b, 8.0) for d in (0.5, 1.0, 2.0) for b in (0, 1, 2)])
    potentials = random.normal(size=(120, len(basis))) @ basis
    thresholds = 1 / true.drive(potentials[..., None])[..., 0].max(axis=1)
    found = fiber_fit.fit(like, 200.0, potentials, thresholds)
    drive = found.drive(potentials[..., None])[..., 0].max(axis=1)
    assert fiber_fit.threshold_error(drive, thresholds).tenth < 0.01


def test_spikes_that_anodes_stop_do_not_count():
    drive = np.array([[1.0, 0.2, -1.5, 0.3], [0.5, -0.6, 0.4, -0.9]])
    fires = drive > 0
    assert passes(drive, np.inf).all()
    assert passes(drive, 2.0)[fires].tolist() == [True, False, True, True, False]
    assert passes(drive, 1.4)[fires].tolist() == [False, False, True, False, False]


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 4), st.floats(0.1, 10))
def test_highest_drive_grows_with_the_current_blocked_or_not(seed, block, factor):
    driving = replace(load_driving("trunk", "through", 200.0), block=block)
    potential = np.random.default_rng(seed).normal(size=(3, 40))
    highest = driving.highest(potential)
    assert driving.highest(factor * potential) == pytest.approx(factor * highest)
    free = driving.drive(potential[..., None])[..., 0].max(axis=1)
    assert np.all(highest <= free)


@pytest.mark.parametrize("strong", sample([2.0, 3.0]))
@pytest.mark.parametrize("gap_mm", sample([2.0, 3.0]))
def test_an_anode_on_the_way_stops_the_spike_of_a_long_pulse(gap_mm, strong):
    """The cable fires at the same current either way after 200 µs, but not after 500 µs."""
    like, along = replace(FIBERS["trunk"], end="through"), np.arange(-24, 25) * 0.5
    cathode, anode = (
        -1000 / (2 * np.pi * 0.43) * disc_potential(np.abs(along - x), np.full(49, 0.9), 0.5)
        for x in (-2.0, gap_mm - 2.0)
    )
    toward = cathode - strong * anode
    both = np.array([toward, toward[::-1]])
    for width_us, ratio in ((200.0, 1.0), (500.0, 2.2)):
        driving = load_driving("trunk", "through", width_us)
        predicted = 1 / driving.highest(both)
        free = 1 / replace(driving, block=np.inf).highest(both)
        cable = fiber_fit.thresholds_ma(both, like, width_us, step_us=width_us / 50)
        assert predicted == pytest.approx(cable, rel=0.1)
        assert cable[0] / cable[1] >= 0.98 * ratio
    assert free[0] < 0.5 * cable[0]


@pytest.mark.parametrize(("end", "width_us", "about", "value"), [
    ("passive", 200.0, "fiber", ("trunk", "passive")),
    ("through", 20.0, "width_us", 20.0),
    ("through", 600.0, "width_us", 600.0),
])  # fmt: skip
def test_what_is_not_offered(end, width_us, about, value):
    with raises(DesignError, value=value):
        load_driving("trunk", end, width_us)
