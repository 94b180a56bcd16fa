"""Tests that a stop ends what users' programs drive, and that they drive no board afterwards."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from smarttouch.emulator.firmware_base import read_state
from smarttouch.running.recording_reader import RecordedRun

from ..boards.emulator_waits import starter, until
from ..support.full import WHOLE, sample

pytestmark = pytest.mark.realtime

PATIENCE_S = 60
SOURCE = Path(__file__).with_name("programs_to_stop.py")
REFUSED = dict.fromkeys(("again", "another", "another run"), "BoardStoppedError")


@pytest.fixture
def start(start_emulator, tmp_path):
    """Return a function that starts a program with an emulated board of its own.

    It returns the process and the folder of the board's delivery log.
    """
    with starter() as start:

        def start_one(kind, url=None):
            _, port, books = start_emulator(64, "link")
            command = [sys.executable, str(SOURCE), kind, url or f"link:{port}"]
            return start(command, cwd=tmp_path, stderr=subprocess.PIPE), books

        yield start_one


def told(process):
    """Wait until a program ends; return how each attempt to drive a board ended, and the output."""
    out, errors = process.communicate(timeout=PATIENCE_S)
    assert errors == ""
    return dict(line.rsplit(" ", 1) for line in out.splitlines() if "ended by" not in line), out


def is_whole(path):
    """Return whether a recording has steps and was closed."""
    recording = RecordedRun(path)
    return any(True for _ in recording.steps()) and recording.whole


@pytest.mark.parametrize(("kind", "first"), sample([
    ("run", {"run": "done"}),
    ("thread", {"run": "done"}),
    ("own handler", {"run": "done"}),
    ("session", {"session": "SmartTouchError"}),
    ("board", {"drive": "BoardStoppedError"}),
    ("left open", {"open": "done", "drive": "BoardStoppedError", "send": "BoardStoppedError"}),
], 3))  # fmt: skip
def test_smarttouch_stop_ends_what_a_program_drives(start, start_program, tmp_path, kind, first):
    process, books = start(kind)
    until(lambda: read_state(books)["slots"] > 50)
    stop = start_program("stop")
    assert f"process {process.pid} has confirmed zero" in stop.communicate(timeout=PATIENCE_S)[0]
    assert stop.returncode == 0
    # Wait for the log, which is written a few times a second. Without a stop it says "silence".
    until(lambda: read_state(books)["reason"] == "stop")
    after = read_state(books)
    assert after["state"] == "shorted"
    attempts, out = told(process)
    if first.keys() & {"run", "session"}:
        assert is_whole(tmp_path / f"{process.pid}.mcap")
    assert attempts == first | REFUSED | ({"again": "BoardError"} if kind == "left open" else {})
    assert "own handler" not in out
    assert process.returncode == 0
    assert read_state(books)["slots"] == after["slots"]


@pytest.mark.parametrize(("kind", "number"), sample([
    ("session", signal.SIGHUP), ("run", signal.SIGTERM), ("thread", signal.SIGTERM),
    ("board", signal.SIGHUP),
]))  # fmt: skip
def test_a_signal_ends_a_program_at_zero_with_its_recording(start, tmp_path, kind, number):
    process, books = start(kind)
    until(lambda: read_state(books)["slots"] > 50)
    process.send_signal(number)
    process.communicate(timeout=PATIENCE_S)
    # A run outside the main thread cannot handle signals, so the signal kills the process. The
    # board then goes to zero after its host timeout.
    assert process.returncode == (-number if kind == "thread" else 128 + number)
    if kind == "thread":
        return
    until(lambda: read_state(books)["reason"] == "stop")
    assert read_state(books)["state"] == "shorted"
    if kind != "board":
        assert is_whole(tmp_path / f"{process.pid}.mcap")


def test_a_program_keeps_a_handler_of_its_own(start, tmp_path):
    process, books = start("own handler")
    until(lambda: read_state(books)["slots"] > 50)
    process.send_signal(signal.SIGTERM)
    assert process.stdout.readline() == "own handler\n"
    before = read_state(books)["slots"]
    until(lambda: read_state(books)["slots"] > before)


def test_a_stop_at_any_instant_reaches_every_program(start, start_program, runs):
    draw = random.Random(33)
    for _ in range(runs or (3 if WHOLE else 1)):
        # All boards of a user together may drive 20 mA at most, which allows two of these boards.
        programs = [start(kind) for kind in draw.sample(["run", "board", "left open"], 2)]
        # When the stop comes, each program may or may not have registered its run.
        time.sleep(draw.uniform(0.05, 2.0))
        stop = start_program("stop")
        answers = stop.communicate(timeout=PATIENCE_S)
        # `smarttouch stop` exits with 1 if neither program had begun to open its board.
        assert stop.returncode in (0, 1), answers
        for _, books in programs:
            until(lambda books=books: read_state(books)["reason"])
        slots = [read_state(books)["slots"] for _, books in programs]
        for process, books in programs:
            attempts, _ = told(process)
            refused = {"BoardStoppedError", "BoardClosedError", "BoardError"}
            assert set(attempts.values()) <= {"done", *refused}
            assert attempts["another"] == attempts["another run"] == "BoardStoppedError"
            assert read_state(books)["reason"] in ("stop", "start")
        assert [read_state(books)["slots"] for _, books in programs] == slots
