"""``profiles`` and ``design`` show what is shipped."""

import json

import numpy as np
import pytest

from smarttouch.profile import profile_names


def test_profiles(program):
    done = program("profiles")
    assert done.returncode == 0
    for name in profile_names():
        assert name in done.stdout
    assert "electric-mouse (default)" in done.stdout


def test_one_site_of_the_paper(program, tmp_path):
    done = program("design", "--profile=line-7", "--mode=sai", "--site=3", "--json=k.json")
    assert done.returncode == 0, done.stderr
    assert "-0.191" in done.stdout
    table = json.loads((tmp_path / "k.json").read_text())
    assert table["mode"] == "SAI"
    (site,) = table["sites"]
    assert site["worst_other"] == pytest.approx(0.3025, abs=5e-5)
    assert site["weights"][3] == 1
    assert abs(site["sum"]) < 1e-6


def test_all_sites(program, tmp_path):
    done = program("design", "--json=k.json")
    assert done.returncode == 0, done.stderr
    sites = json.loads((tmp_path / "k.json").read_text())["sites"]
    assert [site["site"] for site in sites] == list(range(64))
    assert np.shape([site["weights"] for site in sites]) == (64, 64)


def test_a_bank_is_made_anew(program, tmp_path):
    done = program("design", "--profile=smarttouch-4x4", "--bank=bank.npz")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "bank.npz") as bank:
        assert bank["weights_RA"].shape == (16, 16)
