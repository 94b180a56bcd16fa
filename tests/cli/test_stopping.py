"""Tests of a stop before or while a program opens a board, or when its terminal hangs."""

import contextlib
import os
import signal
import termios
import time

import pytest

from smarttouch.boards.run_registry import registry_folder
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.emulator.firmware_base import read_state

from ..boards.emulator_waits import until
from ..support.full import sample
from ..support.processes import PROGRAM, Forked
from .conftest import PRESSED

PATIENCE_S = 30


@pytest.fixture
def deaf():
    """Yield a port without a board, and a function that returns the bytes written to it."""
    line = PtyLine()
    yield line.name, lambda: line.read(0) or b""
    os.close(line._master)


@pytest.mark.parametrize(("number", "name"), sample([
    (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP"), (signal.SIGINT, "Ctrl-C"),
]))  # fmt: skip
def test_a_signal_while_a_board_is_being_opened(start_program, deaf, number, name):
    port, written = deaf
    process = start_program("live", "--board", f"link:{port}", "--intensity", "1")
    until(written)
    process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + number
    assert errors.count("\n") == 1
    assert name in errors


def test_a_stop_before_a_command_opens_its_board(start_program, program_here, deaf):
    """A run is registered before the command designs kernels, so that a stop finds the run."""
    port, written = deaf
    program_here("profiles new --grid 12x12 --pitch 1.4 new.toml").fine()
    process = start_program(
        "live", "--board", f"link:{port}", "--profile", "new.toml", "--intensity", "1", *PRESSED
    )
    until(lambda: list(registry_folder().glob("*.json")))
    stop = start_program("stop")
    assert "has confirmed zero" in stop.communicate(timeout=PATIENCE_S)[0]
    assert stop.returncode == 0
    assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    assert written() == b""


def test_a_program_that_was_started_before_a_stop_drives_nothing(start_program, program_here, deaf):
    """The stop comes while the program still imports modules and has not registered its run."""
    port, written = deaf
    process = start_program("live", "--board", f"link:{port}", "--intensity", "1", real=True)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.02)
    assert program_here("stop").returncode == 1
    process.send_signal(signal.SIGCONT)
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 128 + signal.SIGTERM
    assert "smarttouch stop" in errors
    assert written() == b""


@pytest.fixture
def stuck_terminal():
    """Yield the keyboard end and the program end of a terminal whose output buffer is full."""
    keys, terminal = os.openpty()
    settings = termios.tcgetattr(terminal)
    settings[3] &= ~termios.ECHO
    termios.tcsetattr(terminal, termios.TCSANOW, settings)
    os.set_blocking(terminal, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(terminal, b"." * 64)
    os.set_blocking(terminal, True)
    yield keys, terminal
    for end in (keys, terminal):
        os.close(end)


@pytest.mark.parametrize("end", sample([b"q", signal.SIGINT]))
def test_a_terminal_that_has_stopped_reading_keeps_nobody(
    start_emulator, stuck_terminal, tmp_path, end
):
    keys, terminal = stuck_terminal
    emulator, port, books = start_emulator(64, "link", "linger=0.2")
    process = Forked(
        [PROGRAM, "live", "--board", f"link:{port}", *PRESSED, "--json", "run.json"],
        cwd=tmp_path, stdin=terminal, stdout=terminal, stderr=terminal,
    )  # fmt: skip
    os.write(keys, b"+" * 20)
    until(lambda: read_state(books)["slots"] > 50)
    if isinstance(end, bytes):
        os.write(keys, end)
        # The program waits for the terminal to print its last lines, until a signal ends the wait.
        emulator.wait(PATIENCE_S)
        assert read_state(books)["state"] == "shorted"
        process.send_signal(signal.SIGTERM)
    else:
        process.send_signal(end)
    process.wait(PATIENCE_S)
    emulator.wait(PATIENCE_S)
    state = read_state(books)
    assert (state["state"], state["reason"]) == ("shorted", "stop")
    assert (tmp_path / "run.json").exists()
