"""Simulated finger: afferents by anatomy and seed, and their spikes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import smarttouch
from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ProfileError
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.afferent_anatomy import load_anatomy
from smarttouch.physiology.finger import Finger, axon_path_points
from smarttouch.physiology.membrane import FIBERS, load_driving
from smarttouch.physiology.spikes import SpikeModel, ignore_nan, middle_90, response_quality
from smarttouch.profile import load_profile

from ..fit_fibers_modules import fiber_fit
from ..support.checks import assert_close, raises
from ..support.full import sample

ANATOMIES = ("branched", "paper")


@pytest.fixture(scope="module")
def small():
    return load_profile("smarttouch-4x4")


@pytest.fixture(scope="module", params=ANATOMIES)
def model(small, request):
    return SpikeModel(Finger(small, 3, request.param))


def patterns(profile, seed, slots=8):
    """Return random currents, (S, E) µA, that sum to zero and keep the profile's limits."""
    random = np.random.default_rng(seed)
    raw = random.normal(size=(slots, len(profile.electrodes)))
    raw -= raw.mean(axis=1, keepdims=True)
    limits = profile.limits
    most = 1000 * limits.current_ma / np.abs(raw).max(axis=1)
    if limits.total_ma is not None:
        most = np.minimum(most, 2000 * limits.total_ma / np.abs(raw).sum(axis=1))
    return raw * most[:, None]


@pytest.mark.parametrize("anatomy", ANATOMIES)
def test_the_same_seed_is_the_same_finger(small, anatomy):
    one, again, other = (Finger(small, seed, anatomy) for seed in (1, 1, 2))
    for afferent in Afferent:
        first, second = one.populations[afferent], again.populations[afferent]
        assert np.array_equal(first.axon_path_mm, second.axon_path_mm)
        assert np.array_equal(first.factor, second.factor)
        assert len(first.factor) != len(other.populations[afferent].factor) or not np.allclose(
            first.receptor_mm, other.populations[afferent].receptor_mm
        )


@pytest.mark.parametrize("anatomy", ANATOMIES)
def test_densities_are_those_of_the_anatomy(anatomy):
    finger = Finger(load_profile("electric-mouse"), 1, anatomy)
    area_cm2 = 4 * finger.reach_mm.prod() / 100
    for afferent, density in ((Afferent.RA, 141), (Afferent.SAI, 70), (Afferent.PC, 21)):
        count, expected = len(finger.populations[afferent].factor), density * area_cm2
        assert abs(count - expected) < 4 * np.sqrt(expected)


def test_densities_fall_beyond_the_tip(small):
    anatomy = load_anatomy("paper").model_copy(update={"tip_mm": 5.0, "margin_mm": 10.0})
    finger = Finger(small, 1, anatomy)
    y = finger.receptor_mm[finger.classes == Afferent.RA, 1] + finger.reach_mm[1]
    tip, beyond = np.sum(y < 5) / 5, np.sum(y > 5) / (y.max() - 5)
    assert beyond / tip == pytest.approx(1.6 / 4.2, rel=0.25)


@pytest.mark.parametrize("anatomy", ANATOMIES)
def test_courses_lie_in_the_skin_and_endings_under_ridges(small, anatomy):
    finger = Finger(small, 1, anatomy)
    for one in finger.populations.values():
        assert one.axon_path_mm[..., 2].min() > 0
        assert np.all(np.diff(one.axon_path_mm[..., 2], axis=1) > -1e-9)
    endings = finger.populations[Afferent.RA].axon_path_mm[:, 0, 1] / finger.anatomy.ridge_mm
    assert endings == pytest.approx(np.round(endings), abs=1e-9)


def test_branches_gather_around_the_receptor(small):
    one = Finger(small, 1, "branched").populations[Afferent.RA]
    assert len(one.owner) == one.anatomy.endings * len(one.factor)
    away = one.axon_path_mm[:, 0, :2] - one.receptor_mm[one.owner]
    assert away[:, 0].std() == pytest.approx(one.anatomy.branch_spread_mm, rel=0.15)


def test_nodes_that_are_left_out_are_never_fired_by_legal_currents(small, monkeypatch):
    kept = SpikeModel(Finger(small, 5, "branched"))
    with monkeypatch.context() as every:
        every.setattr(Finger, "_largest_drive", lambda _, rows: np.full(len(rows), np.inf))
        whole = SpikeModel(Finger(small, 5, "branched"))
    assert len(kept.finger.rows[0]) < 0.9 * len(whole.finger.rows[0])
    currents, width = patterns(small, 1, 100), np.full(100, small.pulse.width_us)
    fired = whole.drive(currents, width) >= 1
    assert fired.any()
    assert np.array_equal(kept.drive(currents, width) >= 1, fired)


@pytest.mark.parametrize("total_ma", [None, 5.0])
def test_two_electrodes_reach_nodes_whatever_the_total(small, changed, total_ma):
    array = {"layout": "free", "positions_mm": [[0, 0], [3, 0]]}
    pair = changed(small, {"array": array, "limits.total_ma": total_ma})
    model = SpikeModel(Finger(pair, 1, "branched"))
    assert (model.drive(np.array([[-4000, 4000]]), np.array([200])) >= 1).any()


def test_another_anatomy_from_a_file(tmp_path, small):
    path = tmp_path / "mine.toml"
    path.write_text(
        'title = "One class"\n[ra]\ndensity_per_cm2 = 100\n'
        "[sai]\ndensity_per_cm2 = 0\n[pc]\ndensity_per_cm2 = 0\n"
    )
    finger = Finger(small, 1, path)
    assert finger.anatomy.name == "mine"
    assert set(finger.classes) == {Afferent.RA}
    SpikeModel(finger).drive(patterns(small, 1), np.full(8, 200))


def test_what_is_wrong_with_an_anatomy(tmp_path, small):
    with raises(ProfileError, key="anatomy", value="none-such"):
        Finger(small, 1, "none-such")
    path = tmp_path / "mine.toml"
    path.write_text('title = "x"\n[ra]\ndensity_per_cm2 = -1\n[sai]\n[pc]\nlegs = 3\n')
    with raises(ProfileError, key=lambda about: "density" in about) as caught:
        Finger(small, 1, path)
    said = " ".join(sentence for _, sentence in caught.value.complaints)
    assert all(words in said for words in ("greater than", "is missing", "unknown key"))
    path.write_text("[ra")
    with raises(ProfileError):
        Finger(small, 1, path)


@pytest.mark.parametrize("afferent", sample([Afferent.RA, Afferent.SAI]))
def test_thresholds_of_bent_branches_that_no_fit_has_seen(profile, bank, afferent):
    """On the axon paths of a finger, driving functions give the thresholds of the cable model."""
    one = Finger(profile, 1, "branched").populations[afferent]
    like = replace(FIBERS["fingertip"], end="passive")
    ending = one.axon_path_mm[:, 0, :2]
    picked = np.flatnonzero((np.abs(ending) < 7).all(axis=1))[::40][:16]
    points = axon_path_points(one, picked, 75, like.internode_mm)
    potentials = []
    fields = potential_mv(profile, points)
    for index, (branch, potential) in enumerate(zip(picked, fields, strict=True)):
        away = np.linalg.norm(profile.electrodes.position_mm - ending[branch], axis=1)
        kernel = bank.kernels((Afferent.RA, Afferent.SAI)[index % 2])[away.argmin()]
        potentials.append(potential @ kernel)
    driving = load_driving("fingertip", "passive", 200.0)
    drive = driving.drive(np.array(potentials)[..., None])[..., 0].max(axis=1)
    cable = fiber_fit.thresholds_ma(np.array(potentials), like, 200.0)
    error = fiber_fit.threshold_error(drive, cable)
    assert error.cases == len(picked)
    assert error.median < 0.1
    assert error.worst < 0.25


@pytest.fixture(scope="module")
def finger():
    return Finger(load_profile("smarttouch-4x4"), 2, "paper")


def slots(finger, count=3, current_ma=4.0, width_us=200, discharge_us=100):
    """Return a sequence that drives one electrode against all others in several slots."""
    electrodes = len(finger.profile.electrodes)
    pattern = np.full(electrodes, -1000 * current_ma / (electrodes - 1))
    pattern[5] = 1000 * current_ma
    return SimpleNamespace(
        current_ua=np.tile(pattern, (count, 1)).astype(np.int16),
        width_us=np.full(count, width_us, np.uint16),
        discharge_us=np.full(count, discharge_us, np.uint16),
        period_us=20_000,
    )


def test_an_axon_is_refractory_after_a_spike(finger):
    model = SpikeModel(finger)
    first, second = model.fire(slots(finger)), model.fire(slots(finger))
    assert first.fired.any()
    assert first.counts.max() == 1
    assert second.counts.max() == 1
    assert np.array_equal(first.time_us, [0, 300, 600])
    assert np.array_equal(second.time_us, 20_000 + first.time_us)


def test_a_shorter_pulse_does_less_by_weiss_s_law(finger):
    model, pattern = SpikeModel(finger), slots(finger, 2).current_ua
    long, short = model.drive(pattern, np.array([200, 100])).T
    expected = (1 + 151 / 200) / (1 + 151 / 100)
    assert short == pytest.approx(expected * long, rel=1e-4)


def test_measures_of_what_was_felt(finger):
    places = finger.profile.electrodes.position_mm
    active = np.zeros(len(places), bool)
    active[[0, 15]] = True
    away = np.linalg.norm(finger.receptor_mm - places[0], axis=1)
    ra = np.flatnonzero(finger.classes == Afferent.RA)
    near_ra = ra[away[ra].argmin()]
    beyond = np.linalg.norm(finger.receptor_mm[:, None] - places[active], axis=2).min(axis=1)
    far_sai = np.flatnonzero(finger.classes == Afferent.SAI)
    far_sai = far_sai[beyond[far_sai].argmax()]
    counts = np.zeros(len(finger.classes), np.intp)
    counts[near_ra], counts[far_sai] = 3, 1
    found = response_quality(finger, counts, active, [Afferent.RA])
    assert (found.spikes, found.silent_points) == (4, 0.5)
    assert (found.wrong_class, found.misplaced) == (0.25, 0.25)
    assert found.afferents == {Afferent.RA: 1, Afferent.SAI: 1, Afferent.PC: 0}
    nothing = response_quality(finger, 0 * counts, active, [Afferent.RA])
    assert nothing.silent_points == 1
    assert np.isnan(nothing.wrong_class)
    assert ignore_nan(max, [1.0, nothing.wrong_class]) == 1
    assert np.isnan(ignore_nan(max, [nothing.wrong_class]))
    assert middle_90([nothing.wrong_class, *range(101)]) == pytest.approx((50, 5, 95))
    assert np.isnan(middle_90([nothing.wrong_class])).all()


@pytest.mark.parametrize("widths", [(200,), (100, 200, 500)])
def test_many_slots_fire_what_each_fires_alone(model, widths):
    """The slots include repeated patterns, and equal patterns of different widths."""
    finger = model.finger
    random, electrodes = np.random.default_rng(1), finger.rows[0].shape[1]
    current = np.rint(random.normal(0, 1500, (150, electrodes)))[np.arange(300) // 2]
    width = np.array(widths)[np.arange(300) % len(widths)]
    many, alone = SpikeModel(finger).drive(current, width), SpikeModel(finger)
    for first in range(0, 300, 50):
        part = slice(first, first + 50)
        assert_close(many[:, part], alone.drive(current[part], width[part]), rel=1e-4, abs=1e-4)
    assert np.count_nonzero(many >= 1) > 100


@pytest.fixture(scope="module")
def mouse():
    return smarttouch.Finger(smarttouch.load_profile("electric-mouse"), seed=1, anatomy="paper")


@pytest.fixture(scope="module")
def steps(mouse):
    source = smarttouch.open_source("text:TTTT", mouse.profile, speed_mm_s=30)
    return list(smarttouch.steps(source, mouse.profile, seconds=2.5))


def strongest(steps):
    """Return the step with the highest intensity; on a tie, the one with the most slots."""
    return max(steps, key=lambda step: (step.sequence.intensity, step.sequence.slots))


def test_steps_sequences_and_lists_of_them_give_the_same_response(mouse, steps):
    strong = strongest(steps)
    one, bare, several = (mouse.feel(each) for each in (strong, strong.sequence, [strong]))
    for other in (bare, several):
        np.testing.assert_array_equal(one.counts, other.counts)
    assert one.counts.sum() > 0
    assert (one.wanted, bare.wanted) == ((Afferent.RA,), tuple(Afferent))
    np.testing.assert_array_equal(one.active, strong.tactile.activation.any(axis=0))
    # A sequence has no slots for points that are too faint for a pulse.
    assert not (bare.active & ~one.active).any()
    assert bare.active.any()
    assert bare.quality.wrong_class == 0
    assert one.quality.spikes == one.counts.sum()


def test_a_list_is_one_stretch_of_time(mouse, steps):
    """Sequences of a list follow each other, so refractoriness continues from one to the next."""
    feeling = mouse.feel(steps, seed=3)
    model = SpikeModel(mouse, 3)
    for step, spikes in zip(steps, feeling.spikes, strict=True):
        alone = model.fire(step.sequence)
        np.testing.assert_array_equal(spikes.time_us, alone.time_us)
        # Matrix products of different sizes round differently, so up to 2 spikes may differ.
        assert np.count_nonzero(spikes.fired != alone.fired) <= 2
    np.testing.assert_array_equal(feeling.counts, mouse.feel(steps, seed=3).counts)
