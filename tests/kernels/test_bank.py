"""Kernel banks: shipped banks match their profiles, and damaged files are not used."""

import io
import os
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels import bank as banks
from smarttouch.kernels import switched_design
from smarttouch.kernels.bank import (
    design_bank,
    find_bank,
    load_bank,
    problem_hash,
    shipped_bank,
)
from smarttouch.kernels.batch_design import design_unless_known
from smarttouch.kernels.design_problem import Problem
from smarttouch.kernels.minmax_design import design_kernel
from smarttouch.profile import list_profiles, load_profile

from ..support.checks import raises


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr("platformdirs.user_cache_path", lambda _: tmp_path / "cache")
    return tmp_path / "cache"


@pytest.mark.parametrize("name", list_profiles())
def test_shipped_banks_answer_their_profiles(name, cache, monkeypatch):
    monkeypatch.setattr(banks, "design_bank", None)
    profile = load_profile(name)
    bank = load_bank(profile)
    count = len(profile.electrodes)
    for afferent, weights in bank.weights.items():
        assert weights.shape == bank.receptor[afferent].shape == (count, count)
        assert np.abs(weights.sum(axis=1)).max() < 1e-9
        assert (weights * bank.receptor[afferent]).sum(axis=1) == pytest.approx(
            np.ones(count), rel=1e-4
        )
        assert np.abs(bank.kernels(afferent)).max(axis=1) == pytest.approx(np.ones(count))
        # Skip the ring of `concentric`: the effect of a ring at its center has the opposite sign.
        own = np.diag(weights)[: 1 if name == "concentric" else None]
        if afferent is Afferent.RA:
            assert np.all(own < 0)
        elif afferent is Afferent.SAI:
            assert np.all(own > 0)
    assert not cache.exists()


@pytest.mark.long
@pytest.mark.parametrize(
    ("afferent", "site"), [(Afferent.SAI, 27), (Afferent.RA, 0), (Afferent.PC, 9)]
)
def test_shipped_kernels_can_be_reproduced(profile, bank, afferent, site):
    kernel = design_kernel(Problem(profile, afferent), site)
    strongest = np.abs(kernel.weights).max()
    assert bank.weights[afferent][site] == pytest.approx(kernel.weights, abs=1e-6 * strongest)
    assert bank.off_target[afferent][site] == pytest.approx(kernel.off_target, abs=1e-6)


def test_one_against_all_offers_its_polarity_only():
    bank = load_bank(load_profile("kajimoto-61"))
    row = bank.kernels(Afferent.RA)[30]
    assert row[30] == -1
    assert np.delete(row, 30) == pytest.approx(np.full(60, 1 / 60))
    only_ra = {"value": Afferent.SAI, "allowed": (Afferent.RA,)}
    with raises(DesignError, names="mode", **only_ra) as caught:
        bank.kernels(Afferent.SAI)
    assert "RA (" in str(caught.value), "the message lacks the off-target of RA"


@pytest.fixture
def mine():
    """Return a profile for which no bank is shipped."""
    profile = load_profile("smarttouch-4x4")
    table = profile.model_dump()
    table["name"] = "mine"
    table["array"] |= {"rows": 2, "columns": 3, "pitch_x_mm": 1.8}
    table["skin"]["node_spacing_mm"] = 0.6
    return type(profile).model_validate(table)


def test_a_profile_of_one_s_own_is_designed_once(cache, mine, monkeypatch):
    told = []
    first = load_bank(mine, lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1] > 0
    monkeypatch.setattr(banks, "design_bank", None)
    again = load_bank(mine)
    for afferent in first.weights:
        assert np.array_equal(first.weights[afferent], again.weights[afferent])


def test_an_interrupted_bank_goes_on_where_it_was(cache, mine):
    told = []

    def interrupt(done, total):
        told.append((done, total))
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        load_bank(mine, interrupt)
    (parts,) = cache.iterdir()
    assert len(list(parts.glob("RA-*.json"))) >= 2
    told.clear()
    bank = load_bank(mine, lambda *done: told.append(done))
    assert told[0][0] > 2
    assert [each.suffix for each in cache.iterdir()] == [".npz"]
    whole = design_bank(mine)
    for afferent in whole.weights:
        assert bank.weights[afferent] == pytest.approx(whole.weights[afferent])


@pytest.mark.parametrize("keys", [
    {"optics.rotation_deg": 5.0},
    {"output.ua_per_count": 9.7, "output.wiring": list(range(64))[::-1]},
], ids=["optics", "board"])  # fmt: skip
def test_what_does_not_matter_to_kernels(profile, changed, keys):
    assert problem_hash(changed(profile, keys)) == problem_hash(profile)


@pytest.mark.parametrize(("name", "keys"), [
    ("smarttouch-4x4", {"array.rows": 2, "skin.node_spacing_mm": 0.25}),
    ("etactilekit-32", {"skin.node_spacing_mm": 0.5}), ("line-7", {}),
])  # fmt: skip
def test_a_bank_around_masked_electrodes(name, keys, changed):
    masked = [1, 5]
    mine = changed(load_profile(name), keys | {"output.masked": masked})
    bank, count = design_bank(mine), len(mine.electrodes)
    for afferent, weights in bank.weights.items():
        assert weights.shape == bank.receptor[afferent].shape == (count, count)
        assert not weights[masked].any()
        assert not weights[:, masked].any()
        assert np.abs(weights.sum(axis=1)).max() < 1e-9
        assert np.abs(bank.kernels(afferent)).max(axis=1)[mine.driven] == pytest.approx(1)
        assert not bank.kernels(afferent)[masked].any()
        fired = (weights * bank.receptor[afferent]).sum(axis=1)
        assert fired[mine.driven] == pytest.approx(1, rel=1e-4)
        none = {"value": 5, "electrode": 5}
        with raises(DesignError, names="site", **none):
            bank.kernel(afferent, 5, "weighted")
        assert bank.kernel(afferent, 2, "weighted").off_target > 0


@pytest.mark.long
def test_a_kernel_without_current_at_a_masked_electrode_stays_the_best(profile, bank, changed):
    problem = Problem(changed(profile, {"output.masked": [9]}), Afferent.PC)

    def refuse(problem, site):
        raise AssertionError(f"{problem.describe(site)} was designed")

    keep = design_unless_known(refuse, profile, bank.kernel)
    unused = [site for site in range(64) if site != 9 and abs(bank.weights[2][site][9]) < 1e-9]
    assert len(unused) > 20
    kept, designed = keep(problem, unused[0]), design_kernel(problem, unused[0])
    assert kept.weights[9] == 0
    assert abs(kept.weights.sum()) < 1e-12
    assert kept.off_target == pytest.approx(designed.off_target, rel=1e-3)
    assert kept.spill == pytest.approx(designed.spill, rel=1e-3)
    assert kept.weights == pytest.approx(designed.weights, abs=1e-3 * np.abs(kept.weights).max())
    used = next(site for site in range(64) if site != 9 and bank.weights[2][site][9])
    with pytest.raises(AssertionError, match="was designed"):
        keep(problem, used)


def test_a_kernel_is_kept_only_within_the_limits_of_its_site(profile, bank, changed):
    known, designed = bank.kernel(Afferent.RA, 27, "weighted"), []

    def note(problem, site):
        designed.append(site)
        return known

    own_ma = {"perception.comfort_ma": [1.9] * 64, "perception.threshold_ma": [1.2] * 64}
    for total_ma, expected in ((10.0, []), (9.0, []), (2.0, [27])):
        limited = changed(profile, own_ma | {"limits.total_ma": total_ma})
        problem = SimpleNamespace(profile=limited, afferent=Afferent.RA, driven=limited.driven)
        designed.clear()
        assert (
            design_unless_known(note, profile, bank.kernel)(problem, 27).off_target
            == known.off_target
        )
        assert designed == expected


def test_a_bank_for_other_limits_takes_its_kernels_from_the_shipped_one(changed, monkeypatch):
    monkeypatch.setattr(switched_design, "designer", lambda profile: None)
    line = load_profile("line-7")
    made, shipped = design_bank(changed(line, {"limits.total_ma": 9.9})), load_bank(line)
    for afferent in Afferent:
        assert made.weights[afferent] == pytest.approx(shipped.weights[afferent])


def test_a_weighted_board_s_kernels_do_not_depend_on_impedances(changed):
    for name, alike in (("electric-mouse", True), ("smarttouch-4x4", False)):
        own = load_profile(name)
        kohm = np.linspace(30, 35, len(own.electrodes)).tolist()
        measured = changed(own, {"output.impedance_kohm": kohm})
        assert (problem_hash(measured) == problem_hash(own)) == alike


@pytest.mark.parametrize(
    "damage", ["cut", "flipped", "no archive", "without a class", "another problem", "a pipe"]
)
def test_a_damaged_bank_is_no_bank(cache, mine, damage):
    load_bank(mine)
    assert find_bank(mine) is not None
    (path,) = cache.iterdir()
    data = bytearray(path.read_bytes())
    if damage == "cut":
        del data[len(data) // 2 :]
    elif damage == "flipped":
        with zipfile.ZipFile(path) as archive:
            member = archive.getinfo("weights_RA.npy")
        # Flip a bit in the middle of the data, which begin after a header of about 64 bytes.
        data[member.header_offset + 64 + member.compress_size // 2] ^= 1
    elif damage == "no archive":
        data = b"precious"
    elif damage == "another problem":
        data = shipped_bank("line-7").read_bytes()
    else:
        with np.load(path) as archive:
            arrays = {name: archive[name] for name in archive if name != "gap_RA"}
        np.savez(file := io.BytesIO(), **arrays)
        data = file.getvalue()
    path.unlink()
    if damage == "a pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(data)
    assert find_bank(mine) is None


def test_a_bank_that_cannot_be_kept_is_used_all_the_same(cache, mine, monkeypatch):
    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(banks, "write_bank", full)
    assert Afferent.RA in load_bank(mine).weights


@pytest.mark.long
def test_processes_that_design_one_bank_at_once(tmp_path, mine):
    code = (
        "import sys; from smarttouch.kernels.bank import load_bank; "
        "from smarttouch.profile import Profile; "
        "bank = load_bank(Profile.model_validate_json(sys.argv[1])); "
        "print(sum(float(abs(each).sum()) for each in bank.weights.values()))"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", code, mine.model_dump_json()]
    running = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    told = [each.communicate()[0] for each in running]
    assert [each.returncode for each in running] == [0, 0]
    assert len({round(float(each), 6) for each in told}) == 1
    assert [each.suffix for each in (tmp_path / "smarttouch").iterdir()] == [".npz"]
