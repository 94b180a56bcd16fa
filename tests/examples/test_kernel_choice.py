"""Which kernels fire their class alone: the study in short."""

import numpy as np
import pytest
from studies.finger_effects import inner_sites
from studies.kernel_choice import Reached, choice_rows, picked_rows, reached, share_of

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger

RA = Afferent.RA


def test_a_finger_says_what_each_point_reaches(profile):
    sites, finger = inner_sites(profile)[:4], Finger(profile, 1, "paper")
    full_ma = load_bank(profile).kernels(RA)[sites] * profile.full_ma[sites, None]
    found = reached(finger, {"nodes": {RA: full_ma}}, sites)["nodes"][RA]
    assert found.own.shape == found.other.shape == (4,)
    half = reached(finger, {"nodes": {RA: full_ma / 2}}, sites)["nodes"][RA]
    assert half.own == pytest.approx(found.own / 2, rel=1e-3)
    assert found.alone(0.8).sum() >= 3


def test_the_best_level_is_found_and_what_moves_is_lost():
    # At a level of .5 to .8 the first point fires alone, the second never does.
    still = {"nodes": {RA: Reached(np.array([2.0, 2.0]), np.array([1.2, 4.0]))}}
    moved = {"nodes": {RA: Reached(np.array([0.0, 2.0]), np.array([1.2, 4.0]))}}
    share = share_of([(still, moved, still)] * 2, "nodes", RA)
    assert 0.5 <= share.level <= 1 / 1.2
    assert share.alone == [0.5, 0.5]
    assert share.moved == [0.0, 0.0]
    assert share.silent == [0.0, 0.0]
    # A tenth less than the lowest such level, and nothing is left.
    assert share.off == [0.0, 0.0]
    assert share.layers == [0.5, 0.5]
    assert share.least == 0
    lines = list(choice_rows({"paper": [(still, moved, still)]}, {"nodes": {RA: np.zeros((2, 2))}}))
    assert len(lines) == 3


def test_ten_tries_find_what_is_alone_and_lose_it_when_the_finger_moves():
    kernels = {name: dict.fromkeys((RA, Afferent.SAI), None) for name in ("nodes", "other")}
    bad = Reached(np.full(3, 2.0), np.full(3, 9.0))
    good = Reached(np.full(3, 9.0), np.full(3, 0.1))
    still = {
        "nodes": dict.fromkeys(kernels["nodes"], bad),
        "other": dict.fromkeys(kernels["nodes"], good),
    }
    moved = {"nodes": still["nodes"], "other": still["nodes"]}
    lines = list(picked_rows({"paper": [(still, moved, still)] * 2}, kernels))
    cells = [cell.split()[0] for cell in lines[2].split("|")[3:-1]]
    assert cells == ["0.00", "0.00", "1.00", "0.00", "1.00", "0.00", "1.00", "0.00"]
