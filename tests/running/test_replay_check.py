"""Tests of `check_recording`: golden recordings are reproduced, and small changes are reported."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import entry_points

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import RecordingError
from smarttouch.kernels.bank import load_bank
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.replay_check import KEPT, assert_replays, check_recording
from smarttouch.running.step_records import StepResult
from smarttouch.stimulation.charge_balance import ChargeBalance, RechargeRules
from smarttouch.stimulation.scan_sequence import ScanTiming

from ..support.checks import raises

DIFFERENCE = re.compile(r": (\w+)\[\d+, (\d+)\] (-?\d+) recorded, (-?\d+) now")


def with_weight(bank, afferent, site, electrode, by):
    """Return a copy of a bank. In it, one weight differs by ``by`` times the peak of its kernel."""
    weights = bank.weights[afferent].copy()
    weights[site, electrode] += by * np.abs(weights[site]).max()
    return replace(bank, weights={**bank.weights, afferent: weights})


def strongest_slot(path):
    """Return the step of highest intensity in the first mode, and the index of its last slot."""
    steps = list(RecordedRun(path).steps())
    steps = [each for each in steps if each.step.mode is steps[0].step.mode]
    best = max(
        steps, key=lambda each: each.step.sequence.intensity * bool(each.step.sequence.slots)
    )
    return best, best.step.sequence.slots - 1


def test_goldens_come_out_again_to_the_bit(goldens):
    modes = set()
    for path in goldens:
        report = check_recording(path)
        assert report.exact, report.describe()
        assert report.left_out == ""
        assert report.frames > 5
        assert report.sequences >= 20
        assert report.slots > 50
        modes |= {each.step.mode for each in RecordedRun(path).steps()}
    assert modes == set(Mode)


def test_goldens_hold_what_they_are_for(goldens):
    steps = {path.stem: list(RecordedRun(path).steps()) for path in goldens}
    assert any(each.sent.number is None for each in steps["regulated"])
    assert any(each.step.observed for each in steps["regulated"])
    assert {each.step.level for each in steps["sai-levels"]} == {0.0, 0.4, 0.8, 1.0}
    restarts = [each.index for each in steps["natural"] if each.step.restarted]
    assert len(restarts) == 2
    proved = [each.step.sequence.proof for each in steps["shared"] if each.step.sequence.proof]
    assert max(int(each.points.max(initial=0)) for each in proved) >= 4
    # Points of RA share slots. Each point of SAI has a slot of its own, whose ``points`` is 0.
    assert any((each.points > 1).any() and not each.points.all() for each in proved)


def test_one_weight_changed_by_a_thousandth_is_reported_with_its_place(goldens):
    for path in goldens:
        if path.stem == "regulated":
            # With hold=energy, currents are scaled and rounded again, so many electrodes change.
            continue
        recorded, slot = strongest_slot(path)
        step = recorded.step
        site = int(step.sequence.site[slot])
        afferent = step.mode.afferents[-1]
        profile = RecordedRun(path).profile
        bank = load_bank(profile)
        electrode = int(np.argsort(np.abs(bank.weights[afferent][site]))[-2])
        report = check_recording(path, bank=with_weight(bank, afferent, site, electrode, 1e-3))
        assert not report.exact, path
        assert report.left_out == ""
        # The change is a few µA. A second electrode may change to keep the sum of a slot at zero.
        found = [DIFFERENCE.search(line).groups() for line in report.differences]
        assert {what for what, *_ in found} == {"current_ua"}
        # The report lists only the first differences, which may be in earlier frames.
        place = f"frame {step.input.number} at {step.input.time_ns / 1e9:.3f} s"
        assert place in report.describe() or report.describe().endswith(" more")
        assert str(electrode) in {at for _, at, *_ in found}
        assert len({at for _, at, *_ in found}) <= 2
        assert all(abs(int(new) - int(old)) <= 6 for *_, old, new in found)


def test_another_profile_is_reported(golden, changed):
    path = golden("ra")
    profile = changed(RecordedRun(path).profile, {"limits.ramp_s": 0.9})
    report = check_recording(path, profile=profile)
    assert not report.exact
    assert report.different > len(report.differences) == KEPT
    assert any(": intensity " in line for line in report.differences)
    assert f"{report.different - KEPT:,}" in report.describe().split("\n")[-1]
    with pytest.raises(AssertionError, match=re.escape(f"{path}: {report.describe()}")):
        assert_replays(path, profile=profile)


def test_a_sequence_without_its_slots_is_one_difference(golden, changed):
    path = golden("ra")
    pressed = {"force.contact_n": 50.0, "force.full_n": 60.0}
    report = check_recording(path, profile=changed(RecordedRun(path).profile, pressed))
    words = {re.search(r": (\w+) .*, ([\d.]+) now", line).groups() for line in report.differences}
    assert words == {("slots", "0"), ("intensity", "0.0")}


def test_what_follows_a_gap_is_not_compared(damaged, tmp_path):
    path = tmp_path / "gap.mcap"
    path.write_bytes(damaged)
    report = check_recording(path)
    assert report.exact
    assert 2 < report.sequences < 38
    # The report names the time after which nothing was compared.
    (since_s,) = map(float, re.findall(r"(\d+\.\d) s", report.left_out))
    assert 0 < since_s < RecordedRun(path).seconds
    assert report.left_out in report.describe()


def test_a_cut_one_is_compared_as_far_as_it_goes(recording, cut):
    report, whole = check_recording(cut), check_recording(recording)
    assert report.exact
    assert report.left_out
    assert report.left_out in report.describe()
    assert 0 < report.sequences <= whole.sequences
    assert whole.left_out == ""


def test_nothing_is_not_identical(record, tmp_path):
    path = record(tmp_path / "run.mcap", [])
    with raises(RecordingError, value=path):
        check_recording(path)


@pytest.mark.parametrize(("wrong", "key"), [
    ({}, "mode"), ({"mode": "XY"}, "mode"), ({"timing": {"width_us": "wide"}}, "timing.width_us"),
    ({"hold": "tight"}, "hold"),
])  # fmt: skip
def test_settings_that_are_incomplete(tmp_path, record, about, settings, steps, wrong, key):
    table = json.dumps({**settings, **wrong} if wrong else {})
    path = record(tmp_path / "run.mcap", steps[:2], about={**about, "settings": table})
    with raises(RecordingError):
        check_recording(path)


def test_the_fixture_for_users(golden, tmp_path):
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    (tmp_path / "test_mine.py").write_text(
        f"def test_same(replays):\n    replays({str(golden('ra'))!r})\n\n\n"
        f"def test_not(replays):\n    replays({str(empty)!r})\n"
    )
    # Name the plugin explicitly if the installed package is too old to have its entry point.
    installed = entry_points(group="pytest11", name="smarttouch")
    plugin = [] if installed else ["-p", "smarttouch.testing.pytest_plugin"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", *plugin, "-p", "no:cacheprovider", "."],
        cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False,
    )  # fmt: skip
    assert "1 failed, 1 passed" in done.stdout, done.stdout
    assert f"RecordingError: {empty}" in done.stdout


@pytest.fixture(scope="module")
def balance(profile, bank, make_steps):
    """Return a function that makes steps with recharge phases, given the initial net charge."""

    def make(carried_pc=0):
        pipeline = Pipeline(profile, bank, RunConfig(scan="points", balance=True))
        regulator = pipeline.regulator = Regulator(
            None, ChargeBalance(64), RechargeRules.of(profile, ScanTiming())
        )
        regulator.ledger.charge_pc[:] = carried_pc
        made = []
        for sent in make_steps(40):
            step = pipeline.process(sent.step.input)
            made.append(StepResult(step, sent.number, 99.5, 12.25))
        return made

    return make


@pytest.fixture
def write(record, about, settings, tmp_path):
    """Return a function that records steps with changed settings."""

    def write(steps, name="run", **other):
        table = json.dumps({**settings, "balance": True, **other})
        return record(tmp_path / f"{name}.mcap", steps, about={**about, "settings": table})

    return write


def test_recharge_phases_and_the_charge_before_them_are_known(write, balance):
    carried_pc = np.arange(-32, 32) * 20_000
    for name, carried in (("none", 0), ("some", carried_pc)):
        steps, known = balance(carried), {"carried_pc": carried.tolist()} if name == "some" else {}
        assert sum(each.sequence.recharge_us > 0 for each in steps) > 20
        report = check_recording(write(steps, name, recharge=True, **known))
        assert report.exact, report.describe()
        assert report.sequences == 40
    assert not check_recording(write(steps, "silent", recharge=True)).exact
    path = write(steps, "short", recharge=True, carried_pc=[0] * 63)
    with raises(RecordingError, value=63, allowed=64):
        check_recording(path)
