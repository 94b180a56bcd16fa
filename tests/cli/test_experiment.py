"""Experiments as a user runs them: at a terminal, simulated, stopped, killed and gone on with."""

import io
import json
import os
import re
import signal
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

import smarttouch as st
from smarttouch.base.afferent import Mode
from smarttouch.base.errors import ExperimentError
from smarttouch.base.events import FingerLifted, TrialEvent
from smarttouch.experiments.psychophysics.trial_rows import read_rows
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.recording import RecordedRun
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.views.screen import BlindScreen

from .conftest import refused, says

pytestmark = pytest.mark.usefixtures("patient_boards")

SMALL = "experiment run frequency?standards=30&train_s=0.15"
SIMULATED = f"{SMALL}&gap_s=0.1 --simulate model"
ONCE = SIMULATED.replace("&gap", "&repetitions=1&gap")


def wrong(*names, **attributes):
    return says(ExperimentError, *names, **attributes)


def test_the_list_names_every_experiment(program_here):
    listed = program_here("experiment run").stdout
    for name in ("frequency", "detection", "discomfort", "localization"):
        assert f"\n{name} " in f"\n{listed}"
    assert "staircase" in listed
    assert "free" in listed


def test_a_simulated_session_is_kept_and_gone_on_with(program_here, tmp_path):
    one = f"{ONCE} --subject ann --session 2"
    first = program_here(f"{one} --json run.json").flawless()
    assert "10 of 10 " in first.stdout
    assert "smarttouch experiment fit ann-2-frequency-RA.csv" in first.stdout
    path = tmp_path / "ann-2-frequency-RA.csv"
    before = path.read_bytes()
    assert first.figures["emulator_violations"] == 0
    again = program_here(one)
    # Where answers come from is not said of a session in which none is given.
    assert re.findall(r"\d+", again.stdout.splitlines()[0]) == ["10", "10", "10"]
    assert path.read_bytes() == before
    path.write_bytes(before[:-20])
    rest = program_here(one)
    goes_on = " ".join(rest.stdout.splitlines()[:2])
    assert "10 of 10" in goes_on
    assert "ann-2-frequency-RA.csv" in goes_on
    assert len(read_rows(path)) == 10


def test_recordings_of_a_session_are_numbered(program_here, tmp_path):
    one = f"{ONCE} --output a.csv --record run.mcap"
    program_here(one)
    path = tmp_path / "a.csv"
    path.write_bytes(path.read_bytes()[:-20])
    second = program_here(one)
    assert "run-2.mcap" in second.stdout
    words = [words for _, words in RecordedRun(tmp_path / "run-2.mcap").events]
    trials = [each for each in words if each.startswith(("trial", "response"))]
    assert len(trials) == 2
    assert trials[0].startswith("trial 10: standard 30 Hz, comparison ")
    assert trials[1].startswith("response 10: ")
    assert any(
        each.startswith("trial 1: ") for _, each in RecordedRun(tmp_path / "run.mcap").events
    )


def test_discomfort_ends_with_a_current(program_here, tmp_path):
    result = program_here("experiment run discomfort?repetitions=2&train_s=2 --simulate model")
    rows = read_rows(tmp_path / "discomfort-RA.csv")
    enough = [row.comparison for row in rows if row.success]
    assert len(rows) == 2
    # Lines of the run itself begin with a time.
    summary = re.sub(r"(?m)^[\d.]+ s: .*$", "", result.stdout)
    told = re.findall(r" (\d\.\d{3}) mA", summary)
    assert list(map(float, told)) == ([pytest.approx(np.mean(enough), 1e-3)] if enough else [])


def test_a_person_answers_by_key_and_ends_with_ctrl_c(start_at_a_terminal, tmp_path, monkeypatch):
    # The screen is drawn, though what it is drawn on is kept.
    monkeypatch.setenv("FORCE_COLOR", "1")
    process, keys = start_at_a_terminal(*f"{SMALL}&gap_s=0.1".split(), "--json", "run.json")
    # A key of other runs: the class is the experiment's.
    os.write(keys, b"m")
    path = tmp_path / "frequency-RA.csv"
    drawn = []
    reader = threading.Thread(target=lambda: drawn.extend(iter(lambda: process.stdout.read(1), "")))
    reader.start()
    while process.poll() is None and path.read_bytes().count(b"\n") < 2:
        if "1 or 2" in "".join(drawn):
            os.write(keys, b"1")
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    reader.join(30)
    out = "".join(drawn)
    assert (process.wait(30), process.stderr.read()) == (0, "")
    assert "(Ctrl-C)" in out
    # Whoever answers sees the question, and nothing that would tell the answer.
    assert "1 or 2" in out
    for on_stop in ("RA electrodes", "slots,", "source sees", "comparison", "second after"):
        assert on_stop not in out
    assert re.search(r"\b\d+ of 100\b", out)
    figures = json.loads((tmp_path / "run.json").read_text())
    assert figures["emulator_violations"] == 0
    rows = read_rows(path)
    assert len(rows) >= 1
    assert {row.response for row in rows} == {"1"}
    assert [row.number for row in rows] == list(range(len(rows)))


def test_free_stimulation_by_hand(start_at_a_terminal, tmp_path):
    free = "experiment", "run", "free", "--plain", "--json", "run.json"
    process, keys = start_at_a_terminal(*free)
    for key, words in (
        (b"+", "RA, site 3, 50 Hz, 0.100 mA"), (b"\x1b[C", "RA, site 3, 55 Hz, 0.100 mA"),
        (b"m", "SAI, site 3, 55 Hz, 0.100 mA"), (b"7", "mark: 7"),
    ):  # fmt: skip
        os.write(keys, key)
        while words not in (line := process.stdout.readline()):
            assert line
    os.write(keys, b"q")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    assert "free.mcap" in out
    recorded = [words for _, words in st.load_recording(tmp_path / "free.mcap").events]
    assert "SAI, site 3, 55 Hz, 0.100 mA" in recorded
    assert "mark: 7" in recorded
    figures = json.loads((tmp_path / "run.json").read_text())
    assert figures["emulator_violations"] == 0
    assert figures["max_current_ma"] < 0.11


def test_free_stimulation_for_some_seconds(program_here, tmp_path):
    free = "experiment run free --board simulated: --seconds 1"
    program_here(f"{free} --intensity 0.5").fine()
    assert (tmp_path / "free.mcap").exists()
    assert "free-2.mcap" in program_here(free).stdout


@pytest.mark.parametrize(("arguments", "check"), [
    ("experiment run frequency", wrong()),
    ("experiment run frequency --simulate model --board memory:",
     wrong(value="memory:", allowed=("simulated:",))),
    ("experiment run frequency --simulate me",
     says(value="me", allowed=("model", "random", "first", "silent"))),
    ("experiment run sight --simulate model", wrong("'sight'", "frequency", "localization")),
    (f"{SIMULATED} --subject a/b", says(value="a/b")),
    (SIMULATED.replace("=30", "=30,x"), says(value="30,x")),
    (f"{SIMULATED} --output a.txt", wrong("a.txt", ".csv")),
    ("experiment run free --simulate first", wrong()),
    ("experiment run free --output a.csv", wrong("--output", "--record")),
    ("experiment run free", wrong()),
])  # fmt: skip
def test_what_cannot_be_asked_for(program_here, arguments, check):
    check(refused(program_here(arguments)))


def test_a_participant_s_screen_does_not_show_the_answer(profile, make_frame):
    run = SimpleNamespace(
        source=SimpleNamespace(title="frequency-RA, trial 3 of 50: which was faster? 1 or 2"),
        profile=profile, controls=Controls(ControlState(Mode.RA, 0.5)), board=None,
        statistics=RunStatistics(),
    )  # fmt: skip
    screen = BlindScreen("emulator:", plain=True)
    screen.prepare(run)
    frame = make_frame([[0]], force_n=0.45)
    sequence = SimpleNamespace(rate_hz=45.0, current_ua=None)
    step = SimpleNamespace(input=frame, sequence=sequence)
    screen.step(SimpleNamespace(step=step, first_pulse=None))
    screen.event(TrialEvent(10**9, "trial 3: standard 30 Hz, comparison 45 Hz second"))
    console = Console(width=100, file=io.StringIO())
    console.print(screen._render())
    seen = console.file.getvalue()
    assert all(part in seen for part in run.source.title.split(": "))
    assert "45" not in seen
    assert "Hz" not in seen
    assert f"amplitude {'█' * 10}{'░' * 10}" in seen
    screen.event(FingerLifted(2 * 10**9))
    console.print(screen._render())
    assert "2.0 s: the finger is lifted" in console.file.getvalue()


def test_no_other_participant_goes_on_with_a_file(program_here):
    """Made answers and a person's do not end up in one file."""
    program_here(f"{ONCE} --output a.csv")
    other = program_here(f"{ONCE.replace('--simulate model', '--simulate random')} --output a.csv")
    says(ExperimentError)(refused(other))
