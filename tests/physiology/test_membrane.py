"""Thresholds of the active fiber: against an independent integrator and known physiology."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smarttouch.base.errors import DesignError
from smarttouch.physiology.membrane import Axon, Fiber, threshold_ma, weiss_fit

from ..support.checks import raises
from ..support.full import sample

SPACING_MM = Fiber().internode_mm
TRUNK = {"internode_mm": 0.33}  # 100 outer diameters


def point_mv_per_ma(across_mm, depth_mm):
    """Half space of 0.43 S/m under a point cathode: −ρ / (2π R)."""
    return -1000 / (2 * np.pi * 0.43 * np.hypot(across_mm, depth_mm))


def disc_mv_per_ma(across_mm, depth_mm, radius_mm=0.5):
    """Half space under an equipotential disc cathode."""
    near = np.hypot(across_mm - radius_mm, depth_mm)
    far = np.hypot(across_mm + radius_mm, depth_mm)
    return -1000 / (2 * np.pi * 0.43 * radius_mm) * np.arcsin(2 * radius_mm / (near + far))


def flat(depth_mm, source=point_mv_per_ma, nodes=101):
    return source((np.arange(nodes) - nodes // 2) * SPACING_MM, depth_mm)


def upright(source=disc_mv_per_ma, depth_mm=0.7, nodes=80, internode_mm=SPACING_MM):
    return source(np.zeros(nodes), depth_mm + np.arange(nodes) * internode_mm)


def polarities(potential, fiber, step_us=5.0, **options):
    """Thresholds in steps that serve where digits are of no account."""
    return [
        threshold_ma(potential, fiber, cathodic=cathodic, step_us=step_us, **options)
        for cathodic in (True, False)
    ]


def fires_by_integration(potential, current_ma, width_us):
    """The same equations, written out again per node and left to LSODA; ending active."""
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
    assert 5 < 30 * SPACING_MM * 1000 / delay_us < 15  # m/s; 3 to 5 per µm of diameter
    assert np.abs(course[-1, :40]).max() < 1


def test_an_independent_integrator_finds_the_same_threshold():
    potential = upright(nodes=60)
    threshold = threshold_ma(potential, Fiber(end="active"), cathodic=True)
    assert fires_by_integration(potential, 1.01 * threshold, 200.0)
    assert not fires_by_integration(potential, 0.99 * threshold, 200.0)


@pytest.mark.parametrize(("end", "width_us"), sample([("passive", 50.0), ("active", 200.0)]))
def test_halving_the_step_changes_little(end, width_us):
    fiber = Fiber(end=end)
    normal = polarities(upright(), fiber, width_us=width_us, step_us=2.0)
    halved = polarities(upright(), fiber, width_us=width_us, step_us=1.0)
    assert normal == pytest.approx(halved, rel=0.01)


@pytest.mark.parametrize("cathodic", sample([True, False]))
def test_charge_rises_linearly_with_width(cathodic):
    """Weiss' law within 3 %, from the shortest pulses to the customary 200 µs."""
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


@pytest.mark.parametrize(
    ("depth_mm", "source"), sample([(0.7, disc_mv_per_ma), (1.4, point_mv_per_ma)])
)
def test_flat_fiber_prefers_the_cathode(depth_mm, source):
    cathodic, anodic = polarities(flat(depth_mm, source, 131), Fiber(end="through"))
    assert 3 < anodic / cathodic < 6


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
