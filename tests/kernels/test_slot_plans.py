"""Slots of a frame: every point once, every slot within its bounds, few of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.kernels.frame_fields import FrameBounds
from smarttouch.kernels.frame_judges import FrameJudge, full_wish
from smarttouch.kernels.frame_operator import FrameOperator, keeps
from smarttouch.kernels.slot_plans import likely_slots, plan_slots
from smarttouch.profile import load_profile

from ..whole import WHOLE
from .test_frame_operator import LETTER_T, drawn, scattered


@settings(max_examples=25 if WHOLE else 10, deadline=None)
@given(
    st.sampled_from([Afferent.RA, Afferent.SAI]),
    st.integers(0, 2**32 - 1),
    st.integers(0, 40),
    st.sampled_from([None, 25.0]),
)
def test_every_point_once_and_every_slot_within_its_bounds(
    make_operator, bank, afferent, seed, points, total_ma
):
    operator, bounds = make_operator(afferent), FrameBounds()
    level = scattered(seed, points) * np.random.default_rng(seed).uniform(0.5, 1, 64)
    alone = bank.kernels(afferent) * operator.judge.profile.full_ma[:, None]
    slots = plan_slots(operator, level, bounds, total_ma, alone)
    sites = np.concatenate([np.zeros(0, int), *(slot.sites for slot in slots)])
    assert sorted(sites) == np.flatnonzero(level).tolist()
    for slot in slots:
        wanted = np.where(np.isin(np.arange(64), slot.sites), level, 0)
        assert slot.kept
        assert slot.figures == operator.judge.judge(slot.current, wanted)
        assert keeps(operator.judge, slot.figures, bounds, slot.current, total_ma or 10.0)
        assert slot.current.sum() == pytest.approx(0, abs=1e-3)


def test_few_slots(make_operator):
    operator, letter = make_operator(Afferent.RA), drawn(LETTER_T)
    assert len(plan_slots(operator, letter, FrameBounds())) <= 4, "10 mA carry four points"
    assert len(plan_slots(operator, letter, FrameBounds(uneven=0.15), 50.0)) == 1
    sai = plan_slots(make_operator(Afferent.SAI), letter, FrameBounds())
    assert len(sai) <= 4


def test_total_current_sets_where_a_plan_begins(make_operator):
    operator, level, bounds = make_operator(Afferent.RA), scattered(3, 40), FrameBounds()
    assert likely_slots(operator, np.zeros(64), bounds, 10.0) == 0
    assert likely_slots(operator, level, bounds, None) == 1
    counts = [likely_slots(operator, level, bounds, each) for each in (5.0, 10.0, 20.0)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[1] > counts[2] > 1
    assert likely_slots(operator, 0.5 * level, bounds, 10.0) < counts[1]


def test_a_point_that_breaks_its_bound_stands_alone_with_a_mark(make_operator, bank):
    operator, strict = make_operator(Afferent.SAI), FrameBounds(other=0.01, spill=0.01)
    slots = plan_slots(operator, scattered(5, 4), strict)
    assert [len(slot.sites) for slot in slots] == [1] * 4
    assert not any(slot.kept for slot in slots)
    kernels = 2.4 * np.asarray(bank.kernels(Afferent.SAI), np.float64)
    for slot in plan_slots(operator, 0.6 * scattered(5, 4), strict, points_ma=kernels):
        assert slot.current == pytest.approx(0.6 * kernels[slot.sites[0]])
        assert slot.figures.weakest == pytest.approx(1, abs=1e-3)


def test_points_join_slots_that_they_leave_within_bounds(changed):
    """SAI on points 1.1 mm apart, where selectivity is short; dealing again alone took 25 slots.

    Frames are judged every .5 mm, as `FrameSlots` does. Every .1 mm no point keeps .3 of any other
    class even alone (.32), and none can join another.
    """
    profile = load_profile("optacon-24x6")
    bank, afferent = load_bank(profile), Afferent.SAI
    kernels = bank.kernels(afferent)
    wish = full_wish(profile, kernels, bank.receptor[afferent])
    coarse = changed(profile, {"skin.node_spacing_mm": 0.5})
    operator = FrameOperator(FrameJudge(coarse, afferent, wish))
    slots = 0
    for seed in range(6):
        level = np.zeros(144)
        level[np.random.default_rng(seed).choice(144, 7, replace=False)] = 1.0
        plan = plan_slots(operator, level, FrameBounds(), None, kernels * profile.full_ma[:, None])
        sites = np.concatenate([slot.sites for slot in plan])
        assert sorted(sites) == np.flatnonzero(level).tolist()
        assert all(slot.kept or len(slot.sites) == 1 for slot in plan)
        slots += len(plan)
    assert slots <= 20
