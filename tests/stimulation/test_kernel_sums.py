"""Kernels added up: as many as fit, and what is certain of them is what a judge finds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.frame_operator import AIM, FrameOperator
from smarttouch.kernels.proved_sets import proved_sets
from smarttouch.stimulation.frame_slots import FrameSlots
from smarttouch.stimulation.kernel_sums import _parts
from smarttouch.stimulation.scan_sequence import KernelTable
from smarttouch.stimulation.slot_sums import round_charge_balanced

from ..whole import WHOLE

INTENSITIES = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01, 0.003)


def made(profile, bank, whole):
    """Slots of sums of kernels, in whole numbers or in doubles."""
    slots = FrameSlots(profile, bank, (Afferent.RA,), planned=False)
    if whole:
        slots.table = KernelTable.of(bank.weights, {Afferent.RA: slots.kernels()})
    return slots


@pytest.fixture(scope="module")
def slots(profile, bank):
    return made(profile, bank, whole=False)


@pytest.fixture(scope="module")
def both(profile, bank):
    """The same, without and with a judge for each frame."""
    found = {}
    for whole in (False, True):
        found[whole] = made(profile, bank, whole), made(profile, bank, whole)
        found[whole][1]._sums.certain_from = np.inf
    return found


def activations(count):
    for seed in range(count):
        random = np.random.default_rng(seed)
        drawn = random.random((1, 64), np.float32)
        yield drawn * (random.random((1, 64)) < random.choice([0.05, 0.2, 0.5, 1]))


@given(
    whole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0, 1),
    faintest=st.floats(0, 1),
    intensity=st.one_of(st.floats(0, 0.05), st.floats(0, 1), st.sampled_from(INTENSITIES)),
)
def test_without_a_judge_for_each_frame_currents_are_the_same(
    both, whole, seed, density, faintest, intensity
):
    random = np.random.default_rng(seed)
    activation = random.uniform(faintest, 1, (1, 64)).astype(np.float32)
    activation *= random.random((1, 64)) < density
    found, expected = (each.slots(activation, intensity) for each in both[whole])
    assert np.array_equal(found.current_ua, expected.current_ua)
    assert np.array_equal(found.site, expected.site)
    assert np.array_equal(found.proof.points, expected.proof.points)
    several = found.proof.points > 1
    for name in ("off_target", "spill"):
        stated, true = getattr(found.proof, name), getattr(expected.proof, name)
        assert np.array_equal(stated[~several], true[~several])
        assert (stated[several] >= true[several]).all()


def test_hardly_any_intensity_needs_a_judge(slots, profile):
    sums = slots._sums
    assert 0 < sums.certain_from < 0.02
    worst = sums.figures(sums.certain_from)
    assert worst[0].max() <= profile.frames.other * 1.0001
    assert worst[1].max() <= profile.frames.spill * 1.0001
    assert (sums.figures(1.0) < worst).all()


def test_parts_are_filled_one_after_the_other():
    """Each owner has parts of its own, and what is alone is left out."""
    totals_ma, owners = [6.0, 5.0, 4.0, 4.0, 9.0, 1.0, 1.0], [0, 0, 0, 0, 1, 1, 1]
    parts, most_ma = _parts(totals_ma, owners, 10.0)
    assert parts == [[0, 2], [1, 3], [4, 5]]
    assert most_ma == 10.0
    assert _parts([], [], 10.0) == ([], 0.0)


def test_no_slot_carries_more_than_is_stated(slots):
    for activation in activations(20):
        found = slots._plan(activation).found
        total_ma = np.abs(found.current_ma).sum(axis=1) / 2
        assert (total_ma <= found.most_ma + 1e-9).all()
        assert found.most_ma <= slots._planned_ma


def by_definition(slots, level):
    """Set by set and part by part: the strongest first, each into the first part with room."""
    bounds, aim = slots._planned_bounds, 1 - AIM * slots._planned_bounds.uneven
    rows = []
    for each in proved_sets(FrameOperator(slots._judge), bounds):
        wanted = level[each.sites]
        totals_ma = wanted * aim * each.totals_ma
        parts, sums_ma = [], []
        for index in np.argsort(-totals_ma, kind="stable")[: np.count_nonzero(totals_ma)]:
            room = [sum_ma + totals_ma[index] <= slots._planned_ma for sum_ma in sums_ma]
            part = room.index(True) if any(room) else len(parts)
            if part == len(parts):
                parts.append([])
                sums_ma.append(0.0)
            parts[part].append(index)
            sums_ma[part] += totals_ma[index]
        rows += [aim * wanted[part] @ each.kernels[part] for part in parts if len(part) > 1]
    return np.array(rows).reshape(-1, len(level))


def test_currents_are_those_by_definition(slots):
    for activation in activations(30 if WHOLE else 10):
        level = np.where(activation[0] > 0, 0.5 + 0.5 * activation[0].astype(np.float64), 0)
        found = slots._sums.add_up(level)
        expected_ma = by_definition(slots, level)
        assert found.current_ma == pytest.approx(expected_ma, abs=1e-12)
        for intensity in INTENSITIES:
            sent = round_charge_balanced(1000 * intensity * found.current_ma)
            assert np.array_equal(sent, round_charge_balanced(1000 * intensity * expected_ma))


def test_no_frame_exposes_an_electrode_more_than_all_points_can(slots, profile):
    """By this bound schedulers know that a period is long enough without adding up a frame."""
    for intensity in INTENSITIES:
        for activation in [np.ones((1, 64), np.float32), *activations(30 if WHOLE else 8)]:
            current_ua = slots.slots(activation, intensity).current_ua.astype(np.int64)
            assert (np.abs(current_ua).sum(axis=0) <= slots.most_ua).all()
