"""A board that is halted from another thread is at zero, also while it is being opened."""

import os
import threading

import pytest

from smarttouch.base.errors import BoardError, BoardStoppedError, LineLostError
from smarttouch.base.wire.device_lines import PtyLine
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

PATIENCE_S = 20
LIMITS = SafetyLimits(61, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
OUTPUT = Output(kind="one-against-all")


@pytest.fixture
def deaf_port():
    """A port on which nobody answers."""
    line = PtyLine()
    # Held open, so that what is written is kept and nobody hangs up.
    end = os.open(line.name, os.O_RDWR | os.O_NOCTTY)
    yield line.name
    os.close(end)
    os.close(line._master)


class Opening(threading.Thread):
    """Opens a board, and keeps what that raised."""

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
    monkeypatch.setattr("smarttouch.boards.kits.current_scale.BOOT_S", 600.0)
    monkeypatch.setattr("smarttouch.boards.link.packet_line.ANSWER_S", 600.0)
    board = make_board(f"{kind}:{deaf_port}", LIMITS, OUTPUT)
    assert isinstance(Opening(board).halted(), BoardStoppedError)


def test_halting_ends_the_silence_that_an_etactilekit_is_given(monkeypatch, deaf_port):
    monkeypatch.setattr("smarttouch.boards.kits.current_scale.BOOT_S", 0.0)
    monkeypatch.setattr("smarttouch.boards.kits.etactilekit_line.FORGETS_S", 600.0)
    monkeypatch.setattr("smarttouch.boards.kits.etactilekit_line.CHIPS_S", 0.01)
    board = make_board(f"etactilekit:{deaf_port}", LIMITS, OUTPUT)
    waiting, pause = threading.Event(), board._line.pause

    def tell_and_pause(seconds):
        if seconds == 600.0:
            waiting.set()
        pause(seconds)

    board._line.pause = tell_and_pause
    opening = Opening(board)
    assert waiting.wait(PATIENCE_S)
    assert isinstance(opening.halted(), BoardStoppedError)


def test_halting_ends_the_start_of_an_emulator():
    board = make_board("emulator:", LIMITS)
    board.driver.process._command = ["sleep", "600"]
    opening = Opening(board)
    assert isinstance(opening.halted(), BoardStoppedError)
    process = board.driver.process._process
    assert process is None or process.poll() is not None


def test_halting_ends_the_wait_for_a_port_that_is_gone(monkeypatch, deaf_port):
    """The line breaks in a send, and does not come back."""
    monkeypatch.setattr("smarttouch.boards.line.RECOVER_S", 600.0)
    board = make_board("link:/dev/nowhere", LIMITS, OUTPUT)
    thread = threading.Thread(target=recover, args=(board, raised := []), daemon=True)
    thread.start()
    board.halt()
    thread.join(PATIENCE_S)
    assert [type(error) for error in raised] == [BoardStoppedError]


def recover(board, raised):
    try:
        board._recover(LineLostError("the line broke"))
    except BoardError as error:
        raised.append(error)
