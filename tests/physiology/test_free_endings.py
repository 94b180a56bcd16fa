"""Free endings: what a linear cable predicts fires an active one, and what must not fire."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.anatomy import Bystander, load_anatomy
from smarttouch.physiology.driving_function import STEP_MM, free_ending
from smarttouch.physiology.spikes import Bystanders, margins
from smarttouch.profile import load_profile

from ..whole import sample

NODES, WIDTH_US, STEP_US = 100, 200, 5.0
LASTS_US = 16_000  # long enough for 2.5 mm at the pace of thin fibers
_FASTER = 3 ** ((20 - 6.3) / 10)  # gates at 20 °C


def along_ending(profile, depth_mm, aside_mm):
    x, y = profile.electrodes.position_mm[5]
    depth = depth_mm + STEP_MM * np.arange(NODES)
    points = np.column_stack([np.full(NODES, x + aside_mm), np.full(NODES, y), depth])
    return potential_mv(profile, points)[:, 5]


def gates(v):
    """Opening and closing rates of m, h and n (Hodgkin and Huxley 1952), 1/ms."""
    opening = [
        0.1 * (25 - v) / np.expm1((25 - v) / 10 + 1e-9),
        0.07 * np.exp(-v / 20),
        0.01 * (10 - v) / np.expm1((10 - v) / 10 + 1e-9),
    ]
    return opening, [4 * np.exp(-v / 18), 1 / (np.exp((30 - v) / 10) + 1), np.exp(-v / 80) / 8]


def fires(potential, diameter_um, current_ma):
    """Whether currents (I,) fire a cable with the membrane of Hodgkin and Huxley."""
    coupling = diameter_um / (4 * 100 * (STEP_MM / 10) ** 2) * 1e-4  # 1/µs, as 1 µF/cm²
    bend = np.eye(NODES, k=1) + np.eye(NODES, k=-1)
    bend -= np.diag(bend.sum(axis=1))
    spread, push = expm(coupling * bend * STEP_US).T, coupling * bend @ potential * STEP_US
    push[-1] = 0  # the fiber goes on: the cut is no ending
    v = np.zeros((len(current_ma), NODES))
    gate = [np.full_like(v, each) for each in (0.0529, 0.596, 0.3177)]
    fired = np.zeros(len(v), bool)
    for step in range(int(LASTS_US / STEP_US)):
        for part, opens, closes in zip(gate, *gates(v), strict=True):
            fast = opens + closes
            part += (opens / fast - part) * -np.expm1(-STEP_US / 1000 * _FASTER * fast)
        sodium, potassium = 120 * gate[0] ** 3 * gate[1], 36 * gate[2] ** 4
        total = sodium + potassium + 0.3
        rest = (sodium * 115 - potassium * 12 + 0.3 * 10.6) / total
        v = (rest + (v - rest) * np.exp(-total * STEP_US / 1000)) @ spread
        if step * STEP_US < WIDTH_US:
            v += current_ma[:, None] * push
        v = v.clip(-200, 300)
        fired |= v[:, -8] > 60
    return fired


@pytest.mark.parametrize("diameter_um", sample([0.5, 1.0]))
@pytest.mark.parametrize(("depth_mm", "aside_mm"), [(0.3, 0.0), (0.5, 0.5)])
@pytest.mark.parametrize(("sign", "within"), [(1, (0.8, 1.3)), (-1, (0.6, 1.05))])
def test_the_linear_cable_foretells_an_active_one(diameter_um, depth_mm, aside_mm, sign, within):
    potential = along_ending(load_profile("smarttouch-4x4"), depth_mm, aside_mm)
    driving = free_ending(diameter_um, WIDTH_US)
    expected = 1 / driving.drive(sign * potential[None, :, None])[0, :, 0].max()
    tried = expected * np.array(within)
    assert fires(potential, diameter_um, sign * tried).tolist() == [False, True]


@pytest.fixture(scope="module")
def small():
    return load_profile("smarttouch-4x4")


def pulses(profile, current_ma, sign):
    """One electrode against all others, one after the other."""
    count = len(profile.electrodes)
    pattern = np.full((count, count), -sign * 1000 * current_ma / (count - 1))
    np.fill_diagonal(pattern, sign * 1000 * current_ma)
    return SimpleNamespace(
        current_ua=pattern.astype(np.int16), width_us=np.full(count, WIDTH_US, np.uint16)
    )


def test_margins_scale_with_the_current_and_thick_endings_fire_first(small):
    others = Bystanders(small, 1, "paper")
    assert list(others.populations) == list(Bystander)
    one, two = (margins(others, [pulses(small, each, 1)]) for each in (1.0, 2.0))
    for each in Bystander:
        assert one[each].margin == pytest.approx(2 * two[each].margin, rel=0.02)
        assert one[each].fired <= two[each].fired
        assert (two[each].fired > 0) == (two[each].margin <= 1)
    assert one[Bystander.A_DELTA].margin < one[Bystander.C].margin
    anodic = margins(others, [pulses(small, 1.0, -1)])
    least = min(anodic[each].margin for each in (Bystander.A_DELTA, Bystander.C))
    assert least > 2 * one[Bystander.A_DELTA].margin


def test_a_finger_without_them_has_no_margin(small):
    anatomy = load_anatomy("paper").model_copy(update={"saii": None, "a_delta": None, "c": None})
    assert margins(Bystanders(small, 1, anatomy), []) == {}
