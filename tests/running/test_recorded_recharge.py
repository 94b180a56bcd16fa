"""Recharge phases in recordings: kept, computed again, and reported where they differ."""

import json
import re

import numpy as np
import pytest

from smarttouch.base.errors import RecordingError
from smarttouch.running.check_recording import check_recording
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.recording import RecordedRun, load_recording
from smarttouch.running.step import StepResult
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import ChargeBalance, RechargeRules

from ..raising import raises


@pytest.fixture(scope="module")
def balance(profile, bank, make_steps):
    """Return a maker of the usual steps, balanced by recharge phases from a carried charge on."""

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


@pytest.fixture(scope="module")
def balanced(balance):
    return balance()


@pytest.fixture
def write(record, about, settings, balanced, tmp_path):
    """Return a writer of the recording with other settings."""

    def write(steps=balanced, name="run", **other):
        table = json.dumps({**settings, "balance": True, **other})
        return record(tmp_path / f"{name}.mcap", steps, about={**about, "settings": table})

    return write


def test_they_are_kept_and_come_out_again(write, balanced):
    path = write(recharge=True)
    kept = [each.step.sequence for each in RecordedRun(path).steps()]
    for was, now in zip((each.step.sequence for each in balanced), kept, strict=True):
        assert now.recharge_us == was.recharge_us
        assert np.array_equal(now.recharge_ua, was.recharge_ua)
    assert sum(each.recharge_us > 0 for each in kept) > 20
    report = check_recording(path)
    assert report.exact, report.describe()
    assert report.sequences == 40


def test_charge_that_an_earlier_run_left_is_known(write, balance):
    carried_pc = np.arange(-32, 32) * 20_000
    path = write(balance(carried_pc), recharge=True, carried_pc=carried_pc.tolist())
    report = check_recording(path)
    assert report.exact, report.describe()
    assert not check_recording(write(balance(carried_pc), "silent", recharge=True)).exact
    path = write(name="short", recharge=True, carried_pc=[0] * 63)
    with raises(RecordingError, value=63, allowed=64):
        check_recording(path)


def test_another_threshold_is_reported_with_its_electrode(write, profile, changed):
    path = write(recharge=True)
    higher = changed(
        profile, {"perception.threshold_ma": 1.21, "perception.comfort_ma": (2.4,) * 64}
    )
    report = check_recording(path, profile=higher)
    listed = "\n".join(report.differences)
    recorded, new = re.search(r"recharge_us (\d+) µs recorded, (\d+) µs now", listed).groups()
    assert int(new) < int(recorded)
    assert re.search(r"electrode \d+: recharge_ua", listed)


def test_they_are_arrays(write, balanced):
    arrays = load_recording(write(recharge=True)).arrays
    sequences = [sent.step.sequence for sent in balanced]
    assert arrays.recharge_us.tolist() == [sequence.recharge_us for sequence in sequences]
    for row, sequence in zip(arrays.recharge_ua, sequences, strict=True):
        expected = np.zeros(64) if sequence.recharge_ua is None else sequence.recharge_ua
        assert np.array_equal(row, expected)
