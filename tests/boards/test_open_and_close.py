"""Boards are opened, closed and stopped by several threads, and by a Ctrl-C at any instant."""

import contextlib
import os
import signal
import threading

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.announced import running
from smarttouch.boards.line import Line

from ..raising import raises
from .test_stoppable import PATIENCE_S, Unlined, plain


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
    assert running() == [os.getpid()]
    goes_on.set()
    opening.join(PATIENCE_S)
    assert (board.driver.opened, running()) == (1, [os.getpid()])
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
    assert running() == [os.getpid()] * board._opened
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
    assert (board._opened, running()) == (False, [])


@pytest.mark.parametrize("how", ["stop", "halt", "close"])
def test_a_stop_that_is_interrupted_while_it_waits_still_ends_in_zero(monkeypatch, how):
    """As by a second Ctrl-C; a write under way is waited for."""
    with plain() as board:
        with monkeypatch.context() as interrupted:
            interrupted.setattr(Line, "_bar", lambda _: signal.raise_signal(signal.SIGINT))
            with pytest.raises(KeyboardInterrupt):
                getattr(board, how)()
        assert len(board.driver.zeros) == 1
