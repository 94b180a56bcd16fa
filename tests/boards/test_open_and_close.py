"""Boards are opened, closed and stopped by several threads, and by a Ctrl-C at any instant."""

import contextlib
import os
import signal
import threading

import pytest

from smarttouch.base.errors import BoardError, BoardStoppedError
from smarttouch.boards import board as module
from smarttouch.boards.announced import running
from smarttouch.stimulation.safety_gate import SafetyGate

from ..raising import raises
from .test_stoppable import PATIENCE_S, Plain


def test_a_board_that_two_threads_open_at_once_is_announced_and_opened_once(monkeypatch):
    within, goes_on = threading.Event(), threading.Event()

    def slow(board):
        if within.is_set():
            raise BoardError("as of a port that is in use")
        board.opened += 1
        within.set()
        assert goes_on.wait(PATIENCE_S)

    monkeypatch.setattr(Plain, "_open", slow)
    board = Plain()
    opening = threading.Thread(target=board.open, daemon=True)
    opening.start()
    assert within.wait(PATIENCE_S)
    with raises(BoardError, names="board"):
        board.open()
    assert running() == [os.getpid()]
    goes_on.set()
    opening.join(PATIENCE_S)
    assert (board.opened, running()) == (1, [os.getpid()])
    board.close()


def test_a_board_that_one_thread_closes_while_another_opens_it_is_announced(monkeypatch):
    within, goes_on = threading.Event(), threading.Event()

    def slow(_):
        within.set()
        assert goes_on.wait(PATIENCE_S)

    monkeypatch.setattr(Plain, "_close", slow)
    board = Plain()
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
    looks, look = [], module.seal_fault

    def interrupted(board):
        looks.append(board._opened)
        if board._opened and looks.count(True) == 1:
            raise KeyboardInterrupt
        return look(board)

    monkeypatch.setattr(module, "seal_fault", interrupted)
    board = Plain()
    with pytest.raises(KeyboardInterrupt):
        board.open()
    assert (board._opened, running()) == (False, [])


def test_what_was_proved_before_a_board_was_closed_is_not_sent_when_it_is_open_again(
    monkeypatch, make_sequence
):
    """It may be strong, and what comes first must be weak."""
    sent, raised, proved, goes_on = [], [], threading.Event(), threading.Event()
    prove = SafetyGate.prove

    def slow(gate, *given):
        frozen = prove(gate, *given)
        proved.set()
        assert goes_on.wait(PATIENCE_S)
        return frozen

    def send(board):
        try:
            board.send(make_sequence(0, electrodes=4, period_us=20_000))
        except BoardError as error:
            raised.append(type(error))

    monkeypatch.setattr(Plain, "_send", lambda *given: sent.append(given) or 1)
    with Plain() as board:
        monkeypatch.setattr(SafetyGate, "prove", slow)
        sending = threading.Thread(target=send, args=(board,), daemon=True)
        sending.start()
        assert proved.wait(PATIENCE_S)
        board.close()
        board.open()
        goes_on.set()
        sending.join(PATIENCE_S)
    assert (sent, raised) == ([], [BoardStoppedError])


@pytest.mark.parametrize("how", ["stop", "halt", "close"])
def test_a_stop_that_is_interrupted_while_it_waits_still_ends_in_zero(monkeypatch, how):
    """As by a second Ctrl-C; a write under way is waited for."""
    zeros = []
    monkeypatch.setattr(Plain, "_stop", lambda _: zeros.append(how))
    with Plain() as board:
        with monkeypatch.context() as interrupted:
            interrupted.setattr(Plain, "_interrupt", lambda _: signal.raise_signal(signal.SIGINT))
            with pytest.raises(KeyboardInterrupt):
                getattr(board, how)()
        assert zeros == [how]
