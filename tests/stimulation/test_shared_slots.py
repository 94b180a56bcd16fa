"""Shared slots stay within limits, and stimulate points as strongly as separate slots do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import load_bank
from smarttouch.kernels.design_problem import Problem
from smarttouch.profile import load_profile
from smarttouch.stimulation.scan_sequence import SlotPolicy
from smarttouch.stimulation.scheduler import ScanScheduler, SchedulerContext
from smarttouch.stimulation.slots import FrameSlots, PointSlots

from ..support.checks import raises
from ..support.full import WHOLE
from ..support.scans import prove_alone

_DRAWN = np.zeros((8, 8), np.bool_)
_DRAWN[1, 1:7] = _DRAWN[2:, 3] = True
LETTER_T = np.flatnonzero(_DRAWN)
LETTER = _DRAWN.astype(np.float32).ravel()


@pytest.fixture(scope="module")
def made(profile, bank):
    return {each: FrameSlots(profile, bank, each) for each in (Afferent.RA, Afferent.SAI)}


@pytest.fixture(scope="module")
def slots(made):
    return made[Afferent.RA]


@pytest.fixture(scope="module")
def problems(profile, changed):
    coarse = changed(profile, {"skin.node_spacing_mm": 0.25})
    return {each: Problem(coarse, each) for each in (Afferent.RA, Afferent.SAI)}


def image(activation, afferent=Afferent.RA):
    rows = np.zeros((3, len(activation)), np.float32)
    rows[afferent] = activation
    return TactileImage(rows, 0, 1.0)


@settings(deadline=None, max_examples=25 if WHOLE else 10)
@given(
    afferent=st.sampled_from([Afferent.RA, Afferent.SAI]),
    seed=st.integers(0, 2**32 - 1),
    density=st.floats(0, 0.5),
    intensity=st.floats(0, 1),
)
def test_every_slot_is_within_limits_and_bounds_and_its_proof_is_true(
    profile, bank, made, problems, afferent, seed, density, intensity
):
    random = np.random.default_rng(seed)
    activation = random.random(64, np.float32) * (random.random(64) < density)
    site, current_ua, _, proof, _ = made[afferent].slots(activation, intensity)
    scan = ScanScheduler(
        profile, bank, (afferent,), 10.0, common=SchedulerContext(SlotPolicy((afferent,)))
    )
    sequence = scan.schedule(image(activation, afferent), intensity)
    assert np.array_equal(sequence.current_ua, current_ua)
    prove_alone(profile, sequence)
    assert not current_ua.sum(axis=1).any()
    assert proof.points.sum() == (np.count_nonzero(activation) if intensity > 0 else 0)
    shared = proof.points > 1
    assert (proof.off_target[shared] <= profile.frames.other).all()
    assert (proof.spill[shared] <= profile.frames.spill).all()
    if intensity < 0.05 or not len(site):
        return
    # Compute activations by the design problem, independently of the proof.
    rows = problems[afferent]
    current_ma = current_ua / 1000 / intensity
    level = np.where(activation > 0, 0.5 + 0.5 * activation, 0)
    kernels = bank.kernels(afferent)
    alone = (rows.target * kernels).sum(axis=1) * profile.full_ma * level
    reached = current_ma @ rows.target.T
    others = (current_ma @ rows.other.T).max(axis=1)
    part = np.where(alone > 0, reached / np.where(alone > 0, alone, 1), -np.inf)
    tolerance = 0.01 + 0.04 / intensity
    best = part.max(axis=0)
    assert (best[activation > 0] >= 0.95 - tolerance).all()
    assert (best[activation > 0] <= 1.05 + tolerance).all()
    for slot, points in enumerate(proof.points.tolist()):
        mine = np.argsort(-part[slot])[:points]
        weakest = (reached[slot] / np.where(level > 0, level, np.inf))[mine].min()
        assert site[slot] in mine
        # For a single point, the proof states off-target of the point's kernel before rounding.
        rounding = 0.01 + (0.03 / intensity if points == 1 else 0)
        true = others[slot] / weakest
        if points == 1:
            assert proof.off_target[slot] == pytest.approx(true, rel=0.08, abs=rounding)
        else:
            # For a shared slot, the proof states an upper bound over all frames.
            assert true <= proof.off_target[slot] * 1.08


def test_a_class_is_felt_at_its_own_shift(profile, bank, changed):
    """RA is felt one cell to the right of its site, so the site one cell to the left is used."""
    shifted = changed(profile, {"perception.ra_shift_mm": (2.0, 0.0)})
    activation = np.zeros(64, np.float32)
    activation[45] = 1
    assert FrameSlots(shifted, bank, Afferent.RA).slots(activation, 1.0).site.tolist() == [44]


def test_natural_mode_joins_what_is_proved_with_what_is_not(profile, bank):
    rows = np.zeros((3, 64), np.float32)
    rows[Afferent.RA, LETTER_T] = rows[Afferent.SAI, :3] = 1
    both = (Afferent.RA, Afferent.SAI)
    only_ra, each = (
        ScanScheduler(profile, bank, both, common=SchedulerContext(SlotPolicy(frames))).schedule(
            TactileImage(rows, 0, 1.0), 1.0
        )
        for frames in (both[:1], both)
    )
    count = only_ra.slots - 3
    assert only_ra.points == each.points == len(LETTER_T) + 3
    proof = only_ra.proof
    assert (proof.points[:count] > 0).all()
    assert (proof.points[count:] == 0).all()
    assert np.isnan(proof.off_target[count:]).all()
    assert np.isfinite(each.proof.off_target).all()
    assert (
        ScanScheduler(profile, bank, both).schedule(TactileImage(rows, 0, 1.0), 1.0).proof is None
    )


def test_where_nothing_is_proved_points_are_shown_one_by_one(profile, bank, made):
    """SAI sites cannot share a slot: 16 kernels together activate RA twice as strongly as SAI."""
    activation = np.zeros(64, np.float32)
    activation[:10] = 1
    found = made[Afferent.SAI].slots(activation, 1.0)
    assert found.proof.points.tolist() == [1] * 10
    alone = PointSlots(profile, bank, Afferent.SAI).slots(activation, 1.0)
    order = np.argsort(alone.site)
    assert found.site.tolist() == alone.site[order].tolist()
    assert found.current_ua == pytest.approx(alone.current_ua[order], abs=40)
    assert found.proof.off_target == pytest.approx(bank.off_target[Afferent.SAI][:10], rel=0.02)
    # Activation 0.2 needs level 0.6. It is divided by `_aim`, 0.96; level 1 stays 1.
    faint = made[Afferent.SAI].slots(activation * np.float32(0.2), 1.0)
    assert faint.proof.off_target == pytest.approx(0.6 / 0.96 * found.proof.off_target, rel=1e-3)


def test_a_letter_takes_a_few_slots_and_an_empty_frame_none(slots):
    assert len(slots.slots(0 * LETTER, 1.0)[0]) == 0
    site, _, width_us, *_ = slots.slots(LETTER, 1.0)
    assert len(site) == 4 < len(LETTER_T)
    assert set(site) <= set(LETTER_T)
    assert (width_us == 200).all()
    assert len(slots.slots(LETTER, 0.0)[0]) == 0


def test_masked_electrodes_carry_nothing(profile, changed):
    # Use few electrodes: no bank has kernels for these masks, and designing many is slow.
    few = {"array.rows": 4, "array.columns": 4, "skin.node_spacing_mm": 1.0}
    masked = changed(profile, few | {"output.masked": (5, 6)})
    slots = FrameSlots(masked, load_bank(masked), Afferent.RA)
    site, current_ua, *_ = slots.slots(np.ones(16, np.float32), 1.0)
    assert not current_ua[:, [5, 6]].any()
    assert not set(site) & {5, 6}
    assert current_ua.any()


def test_boards_that_cannot_are_refused(profile, bank, changed):
    board = load_profile("kajimoto-61")
    with raises(ScheduleError, value="output.kind"):
        FrameSlots(board, load_bank(board), Afferent.RA)
    for key, keys in (
        ("frames.share", {"frames.share": False}),
        # Without the key frames.share, points share slots only if limits.total_ma is set.
        ("frames.share", {"limits.total_ma": None, "frames.share": None}),
    ):
        with raises(ScheduleError, value=key):
            FrameSlots(changed(profile, keys), bank, Afferent.RA)


def test_points_that_go_with_no_other_are_rounded_within_their_limit(profile, bank, changed):
    """No sites may share a slot, so each point has its own slot, with current at the limit."""
    keys = {"frames.other": 0.01, "limits.current_ma": 2.35}
    alone = changed(profile, keys | {"perception.comfort_ma": (2.35,) * 64})
    activation = np.zeros(64, np.float32)
    activation[[0, 9, 20, 27, 38, 45]] = 1
    scan = ScanScheduler(
        alone, bank, (Afferent.RA,), 10.0, common=SchedulerContext(SlotPolicy((Afferent.RA,)))
    )
    sequence = scan.schedule(image(activation), 1.0)
    assert sequence.slots == 6
    assert np.abs(sequence.current_ua).max() > 2310
    prove_alone(alone, sequence)


def test_hardly_any_intensity_shows_points_one_by_one(slots):
    assert 0 < slots.certain_from < 0.02
    activation = np.ones(64, np.float32)
    assert len(slots.slots(activation, 0.99 * slots.certain_from).site) == 64
    assert len(slots.slots(activation, slots.certain_from).site) < 64
