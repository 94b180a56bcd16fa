"""Tests of ``smarttouch experiment``: at a terminal, simulated, interrupted and continued."""

import csv
import json
import os
import re
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import ExperimentError, ProfileError, SmartTouchError
from smarttouch.experiments.procedures import constant_stimuli, ratio_pairs
from smarttouch.running.recording_reader import RecordedRun

from ..experiments.simulated import Subject, answer_all, read_rows
from ..support.checks import assert_says
from .conftest import refused, says

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
    one = f"{ONCE} --subject ann --session 2 --record run.mcap"
    first = program_here(f"{one} --json run.json").flawless()
    assert "10 of 10 " in first.stdout
    assert "smarttouch experiment fit ann-2-frequency-RA.csv" in first.stdout
    path = tmp_path / "ann-2-frequency-RA.csv"
    before = path.read_bytes()
    assert first.figures["emulator_violations"] == 0
    again = program_here(one)
    # The session was already complete, so the output does not begin with a note on its answers.
    assert re.findall(r"\d+", again.stdout.splitlines()[0]) == ["10", "10", "10"]
    assert path.read_bytes() == before
    path.write_bytes(before[:-20])
    rest = program_here(one)
    goes_on = " ".join(rest.stdout.splitlines()[:2])
    assert "10 of 10" in goes_on
    assert "ann-2-frequency-RA.csv" in goes_on
    assert [row["participant"] for row in read_rows(path)] == ["ann-simulated-model"] * 10
    # The recording of a continued session gets a number.
    assert "run-2.mcap" in rest.stdout
    words = [words for _, words in RecordedRun(tmp_path / "run-2.mcap").events]
    trials = [each for each in words if each.startswith(("trial", "response"))]
    assert len(trials) == 2
    assert trials[0].startswith("trial 10: standard 30 Hz, comparison ")
    assert trials[1].startswith("response 10: ")
    assert any(
        each.startswith("trial 1: ") for _, each in RecordedRun(tmp_path / "run.mcap").events
    )


def test_a_person_answers_by_key_and_ends_with_ctrl_c(start_at_a_terminal, tmp_path, monkeypatch):
    # Let the program draw its screen although standard output is a pipe.
    monkeypatch.setenv("FORCE_COLOR", "1")
    process, keys = start_at_a_terminal(*f"{SMALL}&gap_s=0.1".split(), "--json", "run.json")
    # Key m changes the class in other runs; an experiment must ignore the key.
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
    # The screen must show the question, but nothing that reveals the answer.
    assert "1 or 2" in out
    for on_stop in ("RA electrodes", "slots,", "source image", "comparison", "second after"):
        assert on_stop not in out
    assert re.search(r"\b\d+ of 100\b", out)
    figures = json.loads((tmp_path / "run.json").read_text())
    assert figures["emulator_violations"] == 0
    rows = read_rows(path)
    assert len(rows) >= 1
    assert {(row["response"], row["participant"]) for row in rows} == {("1", "")}
    assert [row["thisN"] for row in rows] == list(range(len(rows)))


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


@pytest.mark.parametrize(("arguments", "check"), [
    ("experiment run frequency", wrong()),
    ("experiment run frequency --simulate model --board memory:",
     wrong(value="memory:", allowed=("simulated:",))),
    ("experiment run frequency --simulate me",
     says(value="me", allowed=("model", "random"))),
    ("experiment run sight --simulate model", wrong("'sight'", "frequency", "localization")),
    (f"{SIMULATED} --subject a/b", says(value="a/b")),
    (SIMULATED.replace("=30", "=30,x"), wrong(value="30,x")),
    (f"{SIMULATED} --output a.txt", wrong("a.txt", ".csv")),
    ("experiment run free --simulate random", wrong()),
    ("experiment run free --output a.csv", wrong("--output", "--record")),
    ("experiment run free", wrong()),
])  # fmt: skip
def test_what_cannot_be_asked_for(program_here, arguments, check):
    check(refused(program_here(arguments)))


def session(path, thresholds, seed=0):
    """Write simulated trials of each standard. With threshold None, all answers are interval 1."""
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        writer = csv.writer(file)
        writer.writerow(["standard", "comparison", "comparison_interval", "unit", "success"])
        for standard, threshold in thresholds.items():
            procedure = constant_stimuli(ratio_pairs([standard]), 20, seed=seed)
            subject = Subject(threshold or 1.0, 0.2)
            answers = answer_all(procedure, subject.probability, seed + int(standard))
            success = answers.success if threshold else answers.interval == 1
            for row in zip(answers.comparison, answers.interval, success, strict=True):
                writer.writerow([standard, row[0], row[1], "Hz", int(row[2])])


def test_two_modes(program_here, tmp_path):
    session(tmp_path / "RA.csv", {30.0: 36.0, 75.0: None})
    session(tmp_path / "PC.csv", {30.0: 36.0, 75.0: 90.0})
    done = program_here("experiment fit RA.csv PC.csv --plot a.png --json a.json").fine()
    lines = done.stdout.splitlines()
    assert lines[0] == "RA, Hz"
    assert lines[1].split() == [
        "standard", "n", "75%", "at", "Weber", "lower", "middle", "spread", "lapse",
    ]  # fmt: skip
    (without,) = (line for line in lines if line.startswith("75: "))
    assert "200 of 200" in without
    assert max(map(len, lines[:3])) <= 80
    assert (tmp_path / "a.png").stat().st_size > 10_000
    figures = done.figures
    assert list(figures) == ["RA", "PC"]
    good, bad = figures["RA"]
    assert good["threshold"]["value"] == pytest.approx(36, rel=0.1)
    assert bad["threshold"] is None
    assert bad["verdict"]
    row = lines[2].split()
    assert row[:2] == ["30", "200"]
    assert float(row[2]) == pytest.approx(good["threshold"]["value"], rel=0.01)
    assert f"{good['lower_weber']['value']:.0%}" in row


def test_others_answers(figures_of, tmp_path):
    """Data of another program can be fitted, without standards and with other column names."""
    random = np.random.default_rng(2)
    subject = Subject(0.8, 0.3, 0.5, 0.01, guess=0.1)
    felt = [
        f"{level};{'yes' if random.random() < subject.probability(level) else 'no'}"
        for level in (0.0, 0.3, 0.5, 0.7, 0.9, 1.2, 1.6)
        for _ in range(25)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["mA;ok", *felt]))

    def fitted(options):
        (found,) = figures_of(f"experiment fit a.csv --x=mA --y=ok {options}")["a"]
        return found

    assert fitted("--at=0.6")["at"] == 0.6
    found = fitted("--plot=a.svg")
    assert found["standard"] is found["weber"] is None
    assert found["at"] == 0.5
    assert 0 < found["guess"] < 0.3
    assert found["threshold"]["value"] == pytest.approx(0.8, rel=0.2)


@pytest.mark.parametrize(("options", "wrong"), [
    ("none.csv", says(ExperimentError, value=Path("none.csv"))),
    ("a.csv --x hz",
     says(ExperimentError, "a.csv", "comparison or success", value="hz")),
    ("a.csv --plot a.doc", says(SmartTouchError, "a.doc", "end in .png")),
    ("a.csv --plot none/a.png", says(value=Path("none/a.png"))),
])  # fmt: skip
def test_what_a_user_can_do_wrong(program_here, tmp_path, options, wrong):
    (tmp_path / "a.csv").write_text("comparison,success\n1,0\n2,1\n")
    wrong(refused(program_here(f"experiment fit {options}")))


PLAN = (
    'title = "x"\nprofiles = ["smarttouch-4x4"]\nanatomies = ["paper"]\nfingers = 1\nletters = "L"'
)


def test_it_ends_with_one_sentence(program_here, tmp_path):
    (tmp_path / "plan.toml").write_text("fingers = 3")
    error = refused(program_here("simulate study plan.toml --output out"))
    assert type(error) is ProfileError
    assert_says(error, key="title")
    (tmp_path / "plan.toml").write_text(PLAN)
    error = refused(program_here("simulate study plan.toml --output out --cluster nowhere:x"))
    assert_says(error)
