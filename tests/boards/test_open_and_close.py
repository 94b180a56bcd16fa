"""Boards are opened, closed and stopped by several threads, and by a Ctrl-C at any instant."""

import contextlib
import signal
import threading

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.boards.line import Line
from smarttouch.boards.reports import Capabilities
from smarttouch.boards.run_registry import registry_folder
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..raising import raises
from .runs import PATIENCE_S

LIMITS = SafetyLimits(
    electrodes=4, current_ma=2.0, pulse_us=200.0, charge_uc=0.4, rate_hz=50.0, duty=0.5,
    ramp_s=1.0, full_ma=2.0,
)  # fmt: skip


class Unlined(Driver):
    """A driver without a line, whose board may have a finger on it."""

    opened = 0

    def __init__(self):
        self.zeros = []

    def open(self, line, limits):
        self.opened += 1
        self.line = line
        return Capabilities(4, "weighted", 5.0, 8, time_to_zero_ms=0.0, firmware="plain")

    def write(self, proved):
        with self.line.current(proved):
            return

    def zero(self):
        self.zeros.append(threading.get_ident())


def plain():
    return Board(Unlined(), LIMITS)


def announced():
    """Return the number of entries in the run registry."""
    return len(list(registry_folder().glob("*.json")))


def test_a_board_that_two_threads_open_at_once_is_announced_and_opened_once(monkeypatch):
    within, goes_on = threading.Event(), threading.Event()

    own = Unlined.open

    def slow(driver, *given):
        if within.is_set():
            raise BoardError("as of a port that is in use")
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


def test_a_board_that_one_thread_closes_while_another_opens_it_is_announced(monkeypatch):
    within, goes_on = threading.Event(), threading.Event()

    def slow(_):
        within.set()
        assert goes_on.wait(PATIENCE_S)

    monkeypatch.setattr(Unlined, "close", slow)
    board = plain()
    board.open()
    closing = threading.Thread(target=board.close, daemon=True)
    closing.start()
    assert within.wait(PATIENCE_S)
    with contextlib.suppress(BoardError):
        board.open()
    goes_on.set()
    closing.join(PATIENCE_S)
    assert announced() == board._opened
    board.close()


def test_a_board_that_is_interrupted_when_it_is_open_is_closed(monkeypatch):
    """As by Ctrl-C: it would be open, could drive, and be announced no more."""
    looks = []

    def interrupted(line):
        looks.append(line)
        if len(looks) == 3:
            raise KeyboardInterrupt

    # The last look of `open`, when all else is done.
    monkeypatch.setattr(Line, "require_running", interrupted)
    board = plain()
    with pytest.raises(KeyboardInterrupt):
        board.open()
    assert (board._opened, announced()) == (False, 0)


@pytest.mark.parametrize("how", ["stop", "halt", "close"])
def test_a_stop_that_is_interrupted_while_it_waits_still_ends_in_zero(monkeypatch, how):
    """As by Ctrl-C; a write under way is waited for."""
    signals = [signal.SIGINT]
    with plain() as board:
        with monkeypatch.context() as interrupted:
            interrupted.setattr(
                Line, "_bar", lambda _: signals and signal.raise_signal(signals.pop())
            )
            with pytest.raises(KeyboardInterrupt):
                getattr(board, how)()
        assert board.driver.zeros
