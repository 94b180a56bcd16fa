"""The subject's own hand on amplitude, rate, mode and site."""

import csv
import re

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError
from smarttouch.emulator.emulated_boards import SimulatedBoard
from smarttouch.experiments.psychophysics.free_stimulation import (
    FreeLog,
    FreeSource,
    up_to_the_ceiling,
)
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.stimulation.safety_gate import SafetyLimits

from ...looping import loop_through
from ...raising import raises

ALL = tuple(Afferent)


@pytest.fixture(scope="module")
def line():
    return up_to_the_ceiling(load_profile("line-8"))


@pytest.fixture
def play(line, tmp_path):
    """Return a runner: keys and levels by the second, to steps, rows and the board's report."""

    def run_it(seconds, does):
        steps, waiting = [], sorted(does.items())
        log = FreeLog(tmp_path / "free.csv")
        source = FreeSource(line, ALL, log, press_n=1.0)
        controls = Controls(ControlState(Mode.COLOR, 0.0))

        def watch(sent):
            steps.append(sent.step)
            while waiting and sent.step.input.time_ns >= waiting[0][0] * 1e9:
                _, act = waiting.pop(0)
                if isinstance(act, str):
                    source.keys[act]()
                else:
                    controls.change_level(act)

        with SimulatedBoard("", SafetyLimits.of(line), line.output) as board:
            pipeline = Pipeline(line, load_bank(line), RunConfig(mode=Mode.COLOR, scan="points"))
            loop_through(source, pipeline, board, watch, seconds=seconds, controls=controls)
            report = board.report()
        log.close()
        text = (tmp_path / "free.csv").read_text(encoding="utf-8-sig")
        rows = list(csv.DictReader(text.splitlines()))
        return steps, rows, report, source

    return run_it


def test_the_ceiling_is_the_device_s(line):
    assert line.full_ma == pytest.approx(2.0)
    assert line.threshold_ma == pytest.approx(0.4)
    assert line.name == "line-8"


def test_the_ceiling_keeps_charge_and_single_electrodes(profile, changed):
    tight = changed(profile, {"limits.charge_uc": 0.49})
    assert up_to_the_ceiling(tight).full_ma == pytest.approx(2.45 - 0.032)
    single = changed(profile, {"limits.electrode_ma": (2.4,) * 63 + (2.45,)})
    assert up_to_the_ceiling(single).full_ma[[0, -1]] == pytest.approx([2.4, 2.45])


def test_the_amplitude_follows_the_hand_in_milliamperes(play):
    steps, rows, report, source = play(4, {1: 0.5, 2: 0.5})
    strongest = {
        time_s: max(
            np.abs(step.sequence.current_ua).max(initial=0) / 1000
            for step in steps if time_s - 0.1 < step.input.time_ns / 1e9 <= time_s
        )
        for time_s in (0.9, 1.9, 3.9)
    }  # fmt: skip
    assert strongest == pytest.approx({0.9: 0.0, 1.9: 1.0, 3.9: 2.0}, abs=0.005)
    amplitudes = [(row["value"], row["amplitude_ma"]) for row in rows if row["what"] == "amplitude"]
    assert amplitudes == [("0.0", "0.0"), ("1.0", "1.0"), ("2.0", "2.0")]
    assert report.violations == 0
    assert report.max_current_ma <= 2.0
    assert re.findall(r"[\d.]+ mA", source.title) == ["2.00 mA", "2.00 mA"]


def test_a_mode_begins_at_zero(play):
    steps, rows, report, _ = play(4, {1: 0.5, 2: "m"})
    rows_used = [np.flatnonzero(step.input.activation.any(axis=1)).item() for step in steps]
    turn = rows_used.index(int(Afferent.SAI))
    assert steps[turn].sequence.slots == 0
    assert steps[turn].sequence.intensity == 0
    assert steps[turn + 1].sequence.intensity <= 0.05
    assert steps[-1].sequence.intensity == 0.5
    kernels = load_bank(load_profile("line-8")).kernels(Afferent.SAI)
    assert steps[-1].sequence.current_ua[0] == pytest.approx(1000 * kernels[3], abs=5)
    assert ("mode", "SAI") in [(row["what"], row["value"]) for row in rows]
    assert report.violations == 0


def test_rate_and_site_are_turned_and_every_change_is_a_row(play):
    steps, rows, _, source = play(
        3, {0.5: 0.5, 1: "right", 1.5: "left", 1.6: "left", 2: "]", 2.5: "7"}
    )
    assert source.rate_hz == 45
    assert steps[-1].sequence.period_us == 22_222
    assert steps[-1].sequence.site.tolist() == [4]
    assert [(row["what"], row["value"]) for row in rows] == [
        ("amplitude", "0.0"), ("amplitude", "1.0"), ("rate", "55.0"), ("rate", "50.0"),
        ("rate", "45.0"), ("site", "4"), ("mark", "7"),
    ]  # fmt: skip
    assert rows[-1]["rate_hz"] == "45.0"
    assert rows[-1]["mode"] == "RA"
    assert float(rows[-1]["time_s"]) == pytest.approx(2.5, abs=0.05)


def test_rates_stay_within_the_paper_s_range(line, tmp_path):
    log = FreeLog(tmp_path / "free.csv")
    source = FreeSource(line, ALL, log, rate_hz=195, press_n=1.0)
    for _ in range(3):
        source.keys["right"]()
    assert source.read(0).period_us == 5000
    for _ in range(60):
        source.keys["left"]()
    assert source.read(1).period_us == 100_000
    log.close()


def test_rows_are_on_disk_at_once(line, tmp_path):
    log = FreeLog(tmp_path / "free.csv")
    source = FreeSource(line, ALL, log, press_n=1.0)
    told = []
    source.emit = lambda event: told.append(str(event))
    source.keys["m"]()
    source.read(1_000_000)
    assert (tmp_path / "free.csv").read_text(encoding="utf-8-sig").splitlines()[-1] == (
        "0.001,mode,SAI,0.0,0.0,50.0,SAI,3,0.0"
    )
    assert told == ["mode SAI"]
    log.close()
    with raises(ExperimentError, names="file", value=tmp_path / "free.csv"):
        FreeLog(tmp_path / "free.csv")


@pytest.mark.parametrize(("options", "attributes"), [
    ({"rate_hz": 5.0}, {"names": "rate_hz", "value": 5, "allowed": (10, 200)}),
    ({"afferent": Afferent.PC}, {"names": "mode", "value": "PC", "allowed": ("RA",)}),
    ({"site": 8}, {"names": "site", "value": 8}),
])  # fmt: skip
def test_what_cannot_be_asked_for(line, tmp_path, options, attributes):
    with FreeLog(tmp_path / "free.csv") as log, raises(ExperimentError, **attributes):
        FreeSource(line, (Afferent.RA,), log, **options)
