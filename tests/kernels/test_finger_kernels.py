"""Kernels designed on fingers: never worse on their sample, never more current, mirrored."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ProfileError, ScheduleError
from smarttouch.kernels.bank import KernelBank, kernels_at_nodes, load_bank, problem_hash
from smarttouch.kernels.finger_design import SEEN, FingerDesign, FingerSample
from smarttouch.kernels.finger_kernels import FIRST_SEED, FingerKernels
from smarttouch.physiology.finger import Finger
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.stimulation.scan_sequence import NO_SHARING

from ..raising import raises

SITE = 27
MIRRORED = 28


@pytest.fixture(scope="module")
def on_fingers(profile):
    return profile.model_copy(
        update={"kernels": {"objective": "finger", "anatomy": "paper", "fingers": 2}}
    )


@pytest.fixture(scope="module")
def designed(on_fingers):
    design = FingerKernels(on_fingers, kernels_at_nodes(on_fingers))
    return design, design.kernels(Afferent.SAI, [SITE, MIRRORED])


def test_drives_are_those_of_the_finger(profile):
    fingers = [Finger(profile, seed, "paper") for seed in (1, 2)]
    sample = FingerSample.of(fingers)
    current_ma = np.random.default_rng(0).normal(0, 1, (3, 64))
    current_ma -= current_ma.mean(axis=1, keepdims=True)
    highest, node = sample.drives(current_ma)
    rows, starts = fingers[1].rows
    own = np.maximum.reduceat(rows @ current_ma.T.astype(np.float32), starts)
    assert highest[sample.finger == 1] == pytest.approx(own, abs=1e-4)
    afferent, column = np.nonzero(highest >= SEEN)
    drive = (sample.rows[node[afferent, column]] * current_ma[column]).sum(axis=1)
    assert drive == pytest.approx(highest[afferent, column], abs=1e-4)


def test_what_limits_cannot_fire_is_left_out(profile):
    finger = Finger(profile, 1, "paper")
    whole, part = FingerSample.of([finger]), FingerSample.of([finger], 2.4, 5.0)
    assert len(part.rows) < len(whole.rows)
    assert (np.diff([*part.starts, len(part.rows)]) > 0).all()
    point = np.full((1, 64), -2.4 / 63)
    point[0, SITE] = 2.4
    fires = part.drives(point)[0] >= 1
    assert (fires == (whole.drives(point)[0] >= 1)).all()


def test_they_are_balanced_and_need_no_more_current(profile, bank, designed):
    for (kernel, _), site in zip(designed[1], (SITE, MIRRORED), strict=True):
        before = bank.kernels(Afferent.SAI)[site]
        assert abs(kernel.weights.sum()) < 1e-9
        assert np.abs(kernel.weights).max() <= 1 + 1e-6
        assert np.abs(kernel.weights).sum() <= np.abs(before).sum() + 1e-4


def test_they_mirror_one_another(designed):
    (one, _), (other, _) = designed[1]
    mirrored = one.weights.reshape(8, 8)[:, ::-1].ravel()
    assert other.weights == pytest.approx(mirrored, abs=1e-9)


def test_they_are_better_on_their_sample(on_fingers, bank, designed):
    sample = FingerSample.of([Finger(on_fingers, FIRST_SEED + n, "paper") for n in range(2)])
    sites = np.array([SITE, MIRRORED])
    start_ma = np.array(bank.kernels(Afferent.SAI) * on_fingers.full_ma[:, None], float)
    design = FingerDesign(on_fingers, Afferent.SAI, sample, start_ma)
    before, _, _ = design.figures(sites)
    loss = design._loss(sample.drives(start_ma[sites])[0], sites).sum()
    design.current_ma[sites] = [kernel.weights * 2.4 for kernel, _ in designed[1]]
    after, _, worst = design.figures(sites)
    assert design._loss(sample.drives(design.current_ma[sites])[0], sites).sum() < loss
    assert after.mean() < before.mean()
    assert set(worst) <= {Afferent.RA, Afferent.PC}
    assert [kernel.off_target for kernel, _ in designed[1]] == pytest.approx(after)


def test_a_bank_of_them_is_found_again_and_runs_point_by_point(
    profile, bank, changed, monkeypatch, tmp_path
):
    one = {"objective": "finger", "anatomy": "paper", "fingers": 1}
    coarse = changed(profile, {"skin.node_spacing_mm": 0.5})
    on_fingers = coarse.model_copy(update={"kernels": one})
    monkeypatch.setattr("platformdirs.user_cache_path", lambda _: tmp_path)

    def weak(self, afferent, sites, progress=None, keep=None):
        return [(each, 0.0) for each in halved[afferent]]

    halved = {}
    for each in Afferent:
        kernels = [bank.kernel(each, site, "weighted") for site in range(64)]
        for kernel in kernels:
            object.__setattr__(kernel, "weights", kernel.peak_normalized / 2)
        halved[each] = kernels
    monkeypatch.setattr(FingerKernels, "kernels", weak)
    made = load_bank(on_fingers)
    assert isinstance(made, KernelBank)
    assert np.abs(made.kernels(Afferent.RA)).max(axis=1) == pytest.approx(0.5)
    monkeypatch.setattr(FingerKernels, "kernels", None)
    again = load_bank(on_fingers)
    assert (again.kernels(Afferent.RA) == made.kernels(Afferent.RA)).all()
    assert RunConfig(mode="RA").sharing(on_fingers) == NO_SHARING
    with raises(ScheduleError, key="kernels.objective"):
        Pipeline(on_fingers, again, RunConfig(mode="RA", scan="frame"))


def test_the_hash_is_of_all_that_they_depend_on(profile, on_fingers):
    same = profile.model_copy(update={"kernels": {"fingers": 7}})
    assert problem_hash(same) == problem_hash(profile)
    hashes = {problem_hash(profile), problem_hash(on_fingers)}
    for update in (
        {"kernels": {"objective": "finger", "anatomy": "branched", "fingers": 2}},
        {"kernels": {"objective": "finger", "anatomy": "paper", "fingers": 3}},
        {"kernels": {"objective": "finger", "anatomy": ["paper", "branched"], "fingers": 2}},
        {"pulse": profile.pulse.model_copy(update={"width_us": 100})},
        {"perception": profile.perception.model_copy(update={"comfort_ratio": 1.5})},
    ):
        hashes.add(problem_hash(on_fingers.model_copy(update=update)))
    assert len(hashes) == 7


def test_several_anatomies_take_turns(on_fingers, bank):
    both = on_fingers.kernels.model_copy(update={"anatomy": ("paper", "branched")})
    profile = on_fingers.model_copy(update={"kernels": both})
    sample = FingerKernels(profile, bank.kernels)._sample
    fingers = [
        Finger(profile, FIRST_SEED + n, each) for n, each in enumerate(("paper", "branched"))
    ]
    receptors = np.concatenate([each.receptor_mm for each in fingers])
    assert np.array_equal(sample.receptor_mm, receptors)


def test_a_board_with_one_source_is_refused():
    with raises(ProfileError, key="kernels.objective"):
        load_profile("smarttouch-4x4").model_copy(update={"kernels": {"objective": "finger"}})


def test_what_is_kept_is_not_designed_again(on_fingers, designed, monkeypatch, tmp_path):
    design, before = designed
    monkeypatch.setattr(design, "_designed", lambda *_: before)
    design.kernels(Afferent.SAI, [SITE, MIRRORED], keep=tmp_path)
    monkeypatch.setattr(design, "_designed", None)
    again = design.kernels(Afferent.SAI, [SITE, MIRRORED], keep=tmp_path)
    assert [kernel.weights.tolist() for kernel, _ in again] == [
        kernel.weights.tolist() for kernel, _ in before
    ]
