"""The paper's qualitative effects come out of simulated fingers that were not fitted to them."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from studies.finger_effects import (
    CLEAR_MA,
    against_all,
    effects,
    fired,
    inner_sites,
    kernel_ma,
    reached,
    shift,
    stages,
)
from studies.published import EXPERIMENTS, disc_figures, interval, resolves_two_points, table

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import load_profile

SEEDS = range(1, 5)


@pytest.fixture(scope="module")
def mouse():
    profile = load_profile("electric-mouse")
    return SimpleNamespace(
        profile=profile,
        bank=load_bank(profile),
        sites=inner_sites(profile),
        fingers=[Finger(profile, seed, "paper") for seed in SEEDS],
    )


@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_sai_comes_first_in_sai_mode_and_vibration_later(anatomy):
    """Section III-B.1: pressure, then vibration at 1.5 and more of its current."""
    found = stages(anatomy, SEEDS)
    first = {each: current_ma[0] for each, current_ma in found.items()}
    assert min(first, key=first.get) is Afferent.SAI
    assert min(first[Afferent.RA], first[Afferent.PC]) > 1.2 * first[Afferent.SAI]
    assert all((np.diff(current_ma) >= 0).all() for current_ma in found.values())


def test_a_cathode_blurs_what_an_anode_focuses(mouse):
    """Section III-B.5, Fig. 15."""
    anodic, cathodic = (
        shift(
            mouse.fingers, CLEAR_MA * against_all(mouse.profile, each), mouse.sites, list(Afferent)
        )
        for each in (False, True)
    )
    assert cathodic.away_mm > 3 * anodic.away_mm
    assert cathodic.afferents > anodic.afferents > 0


@pytest.mark.parametrize(("flat_mm", "shift_mm"), [(3.0, 1.9), (5.0, 2.7), (7.0, 3.5)])
def test_pc_is_felt_toward_the_fingertip(mouse, flat_mm, shift_mm):
    """Section III-B.4: 1 to 3 mm, which holds of axons taken to run flat for up to 5 mm.

    Means over 20 fingers; those over four of them differ by up to .16 mm. With kernels designed at
    places .1 mm apart, axons of the assumed 7 mm are felt half a millimeter farther than it says.
    """
    anatomy, none = load_anatomy("paper"), {"density_per_cm2": 0.0}
    alone = {each: getattr(anatomy, each).model_copy(update=none) for each in ("ra", "sai")}
    many = {"flat_mm": flat_mm, "density_per_cm2": 210.0}
    alone["pc"] = anatomy.pc.model_copy(update=many)
    fingers = [Finger(mouse.profile, seed, anatomy.model_copy(update=alone)) for seed in SEEDS]
    current_ma = CLEAR_MA * kernel_ma(mouse.profile, mouse.bank, Afferent.PC)
    found = shift(fingers, current_ma, mouse.sites, [Afferent.PC])
    assert -found.y_mm == pytest.approx(shift_mm, abs=0.25)
    assert (1 <= -found.y_mm <= 3) == (flat_mm <= 5)
    assert abs(found.x_mm) < 0.5


@pytest.mark.parametrize(("mode", "most_pc"), [(Afferent.RA, 0.06), (Afferent.SAI, 0.15)])
def test_each_mode_fires_its_class_most(mouse, mode, most_pc):
    """PC are .027 of what RA mode fires, .117 in SAI mode, over 60 fingers.

    Of four fingers the shares differ with a standard deviation of .016 and .018: the bounds are two
    above. (Kernels of places .5 mm apart fired .009 and .115.) RA mode fires no
    PC, says the paper; of SAI mode it says only that it is pure in a narrow range of currents.
    """
    current_ma = CLEAR_MA * kernel_ma(mouse.profile, mouse.bank, mode)[mouse.sites]
    counts = sum(
        np.bincount(one.classes, fired(one, current_ma).sum(axis=1), 3) for one in mouse.fingers
    )
    assert counts.argmax() == mode
    assert counts[Afferent.PC] < most_pc * counts[mode]


def test_an_anodic_disc_in_a_ring_fires_ra_alone():
    """Section III-C: RA mode of the concentric electrode reaches no PC."""
    counts = reached(load_profile("concentric"), -CLEAR_MA, "paper", SEEDS)
    assert counts[Afferent.RA] > 0
    assert counts[Afferent.SAI] == counts[Afferent.PC] == 0


def test_the_table_counts_what_each_mode_fires(mouse):
    found = {effect: shown for effect, _, shown in effects("paper", SEEDS[:2])}
    assert len(found) == 11
    for mode in Afferent:
        (shown,) = (
            each for effect, each in found.items() if effect.startswith(f"{mode.name} mode, 2")
        )
        counts = dict(re.findall(r"(RA|SAI|PC) ([\d.]+)", shown))
        current_ma = CLEAR_MA * kernel_ma(mouse.profile, mouse.bank, mode)[mouse.sites]
        every = [
            np.bincount(one.classes, fired(one, current_ma).sum(axis=1), 3) / len(mouse.sites)
            for one in mouse.fingers[:2]
        ]
        assert {each.name: f"{np.mean(every, axis=0)[each]:.1f}" for each in Afferent} == counts


def test_far_points_are_distinguished_and_one_is_not(mouse):
    current_ma = CLEAR_MA * kernel_ma(mouse.profile, mouse.bank, Afferent.SAI)
    places = mouse.profile.electrodes.position_mm
    apart = [
        resolves_two_points(one, current_ma[[25, 30]], places[[25, 30]]) for one in mouse.fingers
    ]
    once = [resolves_two_points(one, current_ma[[27]], places[[25, 29]]) for one in mouse.fingers]
    assert all(apart)
    assert not any(once)


def test_lone_discs_give_the_figures_of_published_experiments(mouse):
    found = disc_figures(SpikeModel(mouse.fingers[0]))
    # Weiss's law with the anatomy's time constant, whichever afferent is first.
    chronaxie_us = mouse.fingers[0].anatomy.ra.chronaxie_us
    weiss = (1 + chronaxie_us / 1000) / (1 + chronaxie_us / 100)
    assert found["width"] == pytest.approx(weiss, rel=1e-3)
    assert 0.97 < found["train"] < 1
    assert found["burst"] == 6
    assert found["anodic"] < found["cathodic"]


def test_the_table_of_published_experiments_says_what_agrees():
    figures = {each.key: 0.3 for each in EXPERIMENTS}
    lines = list(table({"paper": [figures] * 3, "branched": [figures | {"width": 0.5}] * 3}))
    assert len(lines) == 2 + len(EXPERIMENTS)
    assert {line.count("|") for line in lines} == {8}
    width, delay = (next(line for line in lines if each in line) for each in ("1000 µs", "500 µs"))
    assert "| yes, no |" in width
    assert delay.count("| – ") == 3


def test_the_interval_is_that_of_a_mean():
    values = np.random.default_rng(3).normal(5, 2, 400)
    mean, low, high = interval(values)
    assert mean == pytest.approx(values.mean())
    assert high - low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.1)
