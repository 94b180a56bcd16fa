"""A write that meets a stop is over before zero, or followed by it."""

import threading

import pytest

from smarttouch.boards.board import Board
from smarttouch.boards.open import MemoryDriver


class Noting(MemoryDriver):
    """A driver that notes what flows, and what it does just before that."""

    def __init__(self, before, *given):
        super().__init__(*given)
        self.before, self.did = before, []

    def write(self, proved):
        with self._line.current(proved):
            self.before()
            self.did.append("current")

    def zero(self):
        self.did.append("zero")


def noting(before, limits):
    return Board(Noting(before, "", limits), limits, on_a_finger=False, claimed_time=True)


@pytest.mark.parametrize("long", [False, True])
def test_a_write_that_meets_a_stop_is_over_before_zero_or_followed_by_it(
    monkeypatch, make_limits, make_sequence, long
):
    """As of a driver that was never made for that, with a line that takes its time."""
    if long:
        monkeypatch.setattr("smarttouch.boards.line.WRITE_S", 0.05)
    writing, goes_on = threading.Event(), threading.Event()

    def wait():
        writing.set()
        goes_on.wait(20)

    with noting(wait, make_limits()) as board:
        sender = threading.Thread(target=board.send, args=(make_sequence(0),), daemon=True)
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
        assert board.driver.did == (["zero", "current", "zero"] if long else ["current", "zero"])
