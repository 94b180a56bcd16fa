"""Cable model of a nerve fiber, and driving functions that approximate its thresholds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import disc_potential
from smarttouch.physiology.membrane import (
    FIBERS,
    Axon,
    Fiber,
    load_driving,
    threshold_ma,
    weiss_fit,
)

from ..fit_fibers_modules import fiber_fit
from ..support.checks import raises
from ..support.full import sample

SPACING_MM = Fiber().internode_mm
TRUNK = {"internode_mm": 0.33}  # 100 outer diameters of the fiber


def point_mv_per_ma(across_mm, depth_mm):
    """Return the potential in a half space of 0.43 S/m under a point cathode: −ρ / (2π R)."""
    return -1000 / (2 * np.pi * 0.43 * np.hypot(across_mm, depth_mm))


def disc_mv_per_ma(across_mm, depth_mm, radius_mm=0.5):
    """Return the potential in a half space of 0.43 S/m under an equipotential disc cathode."""
    near = np.hypot(across_mm - radius_mm, depth_mm)
    far = np.hypot(across_mm + radius_mm, depth_mm)
    return -1000 / (2 * np.pi * 0.43 * radius_mm) * np.arcsin(2 * radius_mm / (near + far))


def flat(depth_mm, source=point_mv_per_ma, nodes=101):
    return source((np.arange(nodes) - nodes // 2) * SPACING_MM, depth_mm)


def upright(source=disc_mv_per_ma, depth_mm=0.7, nodes=80, internode_mm=SPACING_MM):
    return source(np.zeros(nodes), depth_mm + np.arange(nodes) * internode_mm)


def polarities(potential, fiber, step_us=5.0, **options):
    """Return the cathodic and the anodic threshold, with coarse but fast time steps."""
    return [
        threshold_ma(potential, fiber, cathodic=cathodic, step_us=step_us, **options)
        for cathodic in (True, False)
    ]


def fires_by_integration(potential, current_ma, width_us):
    """Return whether a fiber with an active ending fires, by a second implementation with LSODA."""
    nodes = potential.size
    axial_us = 1.98e-4 / (4 * 54.7 * SPACING_MM * 0.1 * 2.5 * 1.5e-4)

    def rates(v):
        v = np.clip(v, -200, 200)
        opening_m = (97 + 0.363 * v) / (1 + np.exp((31 - v) / 5.3))
        closing_m = opening_m / np.exp((v - 23.8) / 4.17)
        closing_h = 15.6 / (1 + np.exp((24 - v) / 10))
        opening_h = closing_h / np.exp((v - 5.5) / 5)
        return opening_m / 1e3, closing_m / 1e3, opening_h / 1e3, closing_h / 1e3

    def slopes(_, state, drive):
        v, m, h = state.reshape(3, nodes)
        opening_m, closing_m, opening_h, closing_h = rates(v)
        inside = v + drive
        axial = axial_us * np.diff(np.diff(inside, prepend=inside[0], append=inside[-1]))
        ionic = 1.445 / 2.5 * m**2 * h * (v - 115) + 0.128 / 2.5 * (v + 0.01)
        change_m = opening_m * (1 - m) - closing_m * m
        return np.concatenate([axial - ionic, change_m, opening_h * (1 - h) - closing_h * h])

    opening_m, closing_m, opening_h, closing_h = rates(np.zeros(nodes))
    gates = opening_m / (opening_m + closing_m), opening_h / (opening_h + closing_h)
    state = np.concatenate([np.zeros(nodes), *gates])
    highest = 0.0
    for span_us, drive in ((width_us, current_ma * potential), (700.0, 0 * potential)):
        run = solve_ivp(slopes, (0, span_us), state, "LSODA", args=(drive,), rtol=1e-5, atol=1e-5)
        state = run.y[:, -1]
        highest = max(highest, run.y[nodes - 5].max())
    return highest > 80


def test_an_action_potential_travels_unharmed():
    potential = np.zeros(60)
    potential[0] = -1000.0
    axon = Axon(potential, Fiber(end="active"), 2.0)
    state, course = axon.rest(1), []
    for step in range(400):
        state = axon.advance(state, 0.03 * axon.push[None] if step < 50 else None)
        course.append(state[0][0])
    course = np.array(course)
    assert 85 < course[:, 20].max() < 100
    assert course[:, 50].max() == pytest.approx(course[:, 20].max(), rel=0.01)
    delay_us = 2.0 * (course[:, 50].argmax() - course[:, 20].argmax())
    assert 5 < 30 * SPACING_MM * 1000 / delay_us < 15  # m/s; about 3 per µm of diameter (3.3 µm)
    assert np.abs(course[-1, :40]).max() < 1


def test_an_independent_integrator_finds_the_same_threshold():
    potential = upright(nodes=60)
    threshold = threshold_ma(potential, Fiber(end="active"), cathodic=True)
    assert fires_by_integration(potential, 1.01 * threshold, 200.0)
    assert not fires_by_integration(potential, 0.99 * threshold, 200.0)


@pytest.mark.parametrize("cathodic", sample([True, False]))
def test_charge_rises_linearly_with_width(cathodic):
    """Weiss's law holds within 3 % for pulses of 20 to 200 µs."""
    widths_us = np.array([20.0, 50.0, 100.0, 200.0])
    fiber = Fiber(end="through")
    thresholds = np.array(
        [threshold_ma(flat(0.9), fiber, each, cathodic=cathodic) for each in widths_us]
    )
    rheobase_ma, chronaxie_us = weiss_fit(widths_us, thresholds)
    assert rheobase_ma * (widths_us + chronaxie_us) == pytest.approx(
        widths_us * thresholds, rel=0.03
    )
    assert 20 < chronaxie_us < 100
    assert np.all(np.diff(thresholds) < 0)


@pytest.mark.parametrize(("source", "geometry"), sample([
    (disc_mv_per_ma, {}), (point_mv_per_ma, {}), (disc_mv_per_ma, TRUNK),
], 3))  # fmt: skip
def test_the_ending_decides_what_fires_an_upright_fiber(source, geometry):
    potential = upright(source, **geometry)
    cathodic, anodic = polarities(potential, Fiber(end="passive", **geometry))
    assert anodic < 0.6 * cathodic
    cathodic, anodic = polarities(potential, Fiber(end="active", **geometry))
    assert cathodic < 0.25 * anodic


@pytest.mark.parametrize("scale", [1e-4, 1e6])
def test_no_threshold_is_one_clear_error(scale):
    none = {"value": "anodic", "allowed": (1e-4, 1000)}
    with raises(DesignError, **none):
        threshold_ma(scale * upright(), Fiber(), cathodic=False)


def test_refuses_what_is_no_fiber():
    with pytest.raises(ValueError, match=r"internode_mm=0\.0"):
        Fiber(internode_mm=0.0)
    with pytest.raises(ValueError, match="'open'"):
        Fiber(end="open")
    with pytest.raises(ValueError):
        threshold_ma([1.0], Fiber(), cathodic=True)


OFFERED = [
    ("fingertip", "through"), ("fingertip", "active"), ("fingertip", "passive"),
    ("trunk", "through"), ("trunk", "active"), ("mrg", "through"), ("mrg", "active"),
]  # fmt: skip


def under_a_disc(fiber, depth_mm, beside_mm=0.0, reach_mm=6.0):
    """Return the potential per mA of a disc cathode along a flat or an upright fiber."""
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


@pytest.mark.parametrize(
    ("fiber", "end"), sample([each for each in OFFERED if each[0] != "mrg"], 3)
)
@pytest.mark.parametrize("width_us", sample([150.0, 100.0, 200.0], 3))
def test_thresholds_of_the_cable_under_a_disc(fiber, end, width_us):
    """Driving functions agree with the cable model at places that the fit did not use."""
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
    """Kaczmarek (2000): cathodic RA thresholds of macaques are 1.3 to 1.5 times anodic ones."""
    like = replace(FIBERS["fingertip"], end="passive")
    potential = under_a_disc(like, 0.7)
    cathodic, anodic = (threshold_ma(potential, like, cathodic=each) for each in (True, False))
    assert 1.3 < cathodic / anodic < 1.5
    drive = load_driving("fingertip", "passive", 200.0).drive(
        np.array([potential, -potential])[..., None]
    )
    by_drive = drive.max(axis=(1, 2))
    assert 1 / by_drive == pytest.approx([cathodic, anodic], rel=0.05)


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
    """An anode ahead of the spike doubles the threshold of 500 µs pulses, not of 200 µs pulses."""
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
