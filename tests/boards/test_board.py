"""Boards that several threads open, halt, stop and close, or that Ctrl-C interrupts."""

import gc
import os
import signal
import sys
import threading
from contextlib import suppress
from dataclasses import replace

import pytest

from smarttouch.base.errors import BoardError, BoardStoppedError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import Capabilities
from smarttouch.boards.run_registry import registry_folder
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises
from .emulator_waits import PATIENCE_S, until

LIMITS = SafetyLimits(
    electrodes=4, current_ma=2.0, pulse_us=200.0, charge_uc=0.4, rate_hz=50.0, duty=0.5,
    ramp_s=1.0, full_ma=2.0,
)  # fmt: skip


class Unlined(Driver):
    """Driver without a port that records its actions, and runs ``before`` ahead of each current."""

    opened = 0
    can = Capabilities(4, "weighted", 5.0, 8, time_to_zero_ms=0.0, firmware="plain")

    def __init__(self, before=lambda: None):
        self.before, self.did = before, []

    def open(self, line, limits):
        self.opened += 1
        self.line = line
        return self.can

    def write(self, proved):
        with self.line.current(proved):
            self.before()
            self.did.append("current")

    def zero(self):
        self.did.append("zero")


def plain(before=lambda: None):
    return Board(Unlined(before), LIMITS)


def announced():
    """Return the number of entries in the run registry."""
    return len(list(registry_folder().glob("*.json")))


FIVE = Capabilities(5, "weighted", 5.0, 8, time_to_zero_ms=0.0, firmware="plain")


@pytest.mark.parametrize("answer", [None, FIVE])
def test_a_device_of_another_kind_is_not_opened(monkeypatch, answer):
    monkeypatch.setattr(Unlined, "open", lambda *_: answer)
    with pytest.raises(BoardError, match="4 electrodes"), plain():
        pass


def test_a_board_that_two_threads_open_at_once_is_announced_and_opened_once(monkeypatch):
    within, goes_on = threading.Event(), threading.Event()

    own = Unlined.open

    def slow(driver, *given):
        if within.is_set():
            raise BoardError("the port is in use")
        within.set()
        assert goes_on.wait(PATIENCE_S)
        return own(driver, *given)

    monkeypatch.setattr(Unlined, "open", slow)
    board = plain()
    opening = threading.Thread(target=board.open, daemon=True)
    opening.start()
    assert within.wait(PATIENCE_S)
    with raises(BoardError, names="board"):
        board.open()
    assert announced() == 1
    goes_on.set()
    opening.join(PATIENCE_S)
    assert (board.driver.opened, announced()) == (1, 1)
    board.close()


def test_a_board_that_is_interrupted_when_it_is_open_is_closed(monkeypatch):
    """A board that stayed open could drive a finger without an entry in the run registry."""
    looks = []

    def interrupted(line):
        looks.append(line)
        if len(looks) == 3:
            raise KeyboardInterrupt

    # The third check is the last step of `open`.
    monkeypatch.setattr(Line, "require_running", interrupted)
    board = plain()
    with pytest.raises(KeyboardInterrupt):
        board.open()
    assert (board._opened, announced()) == (False, 0)


@pytest.mark.parametrize("how", ["stop", "halt", "close"])
def test_a_stop_that_is_interrupted_while_it_waits_still_ends_in_zero(monkeypatch, how):
    """Ctrl-C comes while the stop waits for the end of a write."""
    signals = [signal.SIGINT]
    with plain() as board:
        with monkeypatch.context() as interrupted:
            interrupted.setattr(
                Line, "_bar", lambda _: signals and signal.raise_signal(signals.pop())
            )
            with pytest.raises(KeyboardInterrupt):
                getattr(board, how)()
        assert "zero" in board.driver.did


def test_ctrl_c_waits_for_the_end_of_a_write(make_sequence):
    board = plain(lambda: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt), board:
        board.send(make_sequence(0, electrodes=4, period_us=20_000))
    assert board.driver.did.count("current") == 1
    assert board.driver.did[-1] == "zero"


@pytest.mark.parametrize("host_timed", [False, True])
@pytest.mark.parametrize("broken", [RuntimeError("it broke"), BoardError("it cannot make this")])
def test_a_driver_that_breaks_says_so(monkeypatch, make_sequence, host_timed, broken):
    """If the sender thread fails, it sets the board to zero, and the next call raises the error."""

    def write(*_):
        raise broken

    monkeypatch.setattr(Unlined, "write", write)
    monkeypatch.setattr(Unlined, "can", replace(Unlined.can, host_timed=host_timed))
    board, silent = plain(), make_sequence(0, electrodes=4, period_us=20_000)
    with board:
        if host_timed:
            board.send(silent)
            until(lambda: "zero" in board.driver.did)
        with pytest.raises((RuntimeError, BoardError)) as error:
            board.send(replace(silent, time_ns=10**9))
    assert broken in (error.value, error.value.__cause__)


KIT_LIMITS = SafetyLimits(61, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
OUTPUT = Output(kind="one-against-all")


@pytest.fixture
def deaf_port():
    """Return the name of a port on which no device answers."""
    line = PtyLine()
    # Keep the device side open: otherwise the port hangs up and drops what is written.
    end = os.open(line.name, os.O_RDWR | os.O_NOCTTY)
    yield line.name
    os.close(end)
    os.close(line._master)


class Opening(threading.Thread):
    """Thread that opens a board, and keeps the error if that fails."""

    def __init__(self, board):
        super().__init__(daemon=True)
        self.board, self.raised = board, None
        self.start()

    def run(self):
        try:
            self.board.open()
        except BoardError as error:
            self.raised = error

    def halted(self):
        self.board.halt()
        self.join(PATIENCE_S)
        assert not self.is_alive()
        return self.raised


@pytest.mark.parametrize("kind", ["kajimoto61", "etactilekit", "link"])
def test_halting_ends_the_wait_for_a_board_that_does_not_answer(monkeypatch, deaf_port, kind):
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 600.0)
    monkeypatch.setattr("smarttouch.boards.link.link_driver.ANSWER_S", 600.0)
    board = make_board(f"{kind}:{deaf_port}", KIT_LIMITS, OUTPUT)
    assert isinstance(Opening(board).halted(), BoardStoppedError)


@pytest.mark.parametrize("kind", ["kajimoto61", "etactilekit"])
def test_nothing_is_written_before_a_kit_has_booted(monkeypatch, deaf_port, kind):
    did = []
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 12.5)
    monkeypatch.setattr(Line, "pause", lambda _line, pause_s: did.append(pause_s))
    monkeypatch.setattr(Line, "write", lambda _line, data, *_: did.append(data))
    with suppress(BoardError), make_board(f"{kind}:{deaf_port}", KIT_LIMITS, OUTPUT):
        pass
    written = [isinstance(each, bytes) for each in did]
    assert 12.5 in did[: written.index(True)]


def test_halting_ends_the_start_of_an_emulator(monkeypatch, tmp_path):
    slow = tmp_path / "slow"
    slow.write_text("#!/bin/sh\nexec sleep 600\n")
    slow.chmod(0o755)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "executable", str(slow))
        board = make_board("emulator:", KIT_LIMITS)
    opening = Opening(board)
    assert isinstance(opening.halted(), BoardStoppedError)
    process = board.driver.process
    process.end()
    assert process.has_ended


def test_an_emulator_ends_with_its_board():
    """An emulator starts with its driver. It ends even if the board is never opened."""
    unopened = make_board("emulator:", KIT_LIMITS)
    process = unopened.driver.process._process
    assert process.poll() is None
    del unopened
    gc.collect()
    assert process.poll() is not None
    board = make_board("emulator:", KIT_LIMITS)
    for _ in range(2):
        with board:
            assert not board.driver.process.has_ended
        assert board.driver.process._process.returncode == 0


@pytest.mark.parametrize("long", [False, True])
def test_a_write_that_meets_a_stop_is_over_before_zero_or_followed_by_it(
    monkeypatch, make_sequence, long
):
    """The write ignores the stop. If ``long``, the stop gives up waiting for the write."""
    if long:
        monkeypatch.setattr("smarttouch.boards.driver.WRITE_S", 0.05)
    writing, goes_on = threading.Event(), threading.Event()

    def wait():
        writing.set()
        goes_on.wait(20)

    with plain(wait) as board:
        silent = make_sequence(0, electrodes=4, period_us=20_000)
        sender = threading.Thread(target=board.send, args=(silent,), daemon=True)
        stopper = threading.Thread(target=board.stop, daemon=True)
        sender.start()
        assert writing.wait(20)
        stopper.start()
        assert board._stopped.wait(20)
        if long:
            stopper.join(20)
        goes_on.set()
        for each in (sender, stopper):
            each.join(20)
        # The thread that writes and the thread that stops both set the board to zero.
        assert board.driver.did == (
            ["zero", "current", "zero"] if long else ["current", "zero", "zero"]
        )
