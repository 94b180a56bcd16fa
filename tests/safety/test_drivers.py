"""Drivers that change what keeps their boards safe: each is refused, with its board at zero."""

import dataclasses
import types

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.boards.kits.streamed import StreamedBoard
from smarttouch.boards.open import make_board
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..raising import raises

# What is refused is so however long the computer pauses.
pytestmark = pytest.mark.usefixtures("patient_boards")

WIDE = SafetyLimits(8, 5.0, 200, 0.5, 100, 0.6, 0.5, 5.0)


def allowed():
    return SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.43)


class Theirs(Board):
    """A driver of another package: what it changes, and when."""

    at, change = "", staticmethod(lambda board: None)

    def __init__(self, limits):
        super().__init__(
            limits, max_current_ma=5.0, max_slots=256, time_to_zero_ms=0.0, firmware=""
        )
        self.flows, self.stops = [], 0

    def _open(self):
        if self.at == "open":
            type(self).change(self)

    def _send(self, sequence, times):
        if self.at == "send" and not self.flows:
            type(self).change(self)
        self.flows.append(int(abs(sequence.current_ua).max(initial=0)))
        return len(self.flows)

    def _stop(self):
        self.stops += 1


def sequence(step, level_ua=0):
    row = np.array([[level_ua, -level_ua, 0, 0, 0, 0, 0, 0]], np.int16)[: level_ua > 0]
    one = np.ones(len(row), np.uint16)
    return ScanSequence(row, one * 100, one * 50, one, 20_000, 0.1 * (level_ua > 0), step * 10**9)


def wider_fields(board):
    for name in ("current_ma", "full_ma"):
        object.__setattr__(board._gate.limits, name, 5.0)


def wider_whole_numbers(board):
    vars(board._gate.limits)["most_ua_line"] = (5000, 0, 1)


def other_array(board):
    limits = board._gate.limits
    vars(limits)["current_ua"] = limits.current_ua + 2000


def other_gate_clock(board):
    board._gate._clock = types.SimpleNamespace(now_ns=lambda: 0)


def other_clock(board):
    board._clock = types.SimpleNamespace(now_ns=lambda: 0)


def own_now(board):
    board._clock.now_ns = lambda: 0


def made_again(board):
    opened = board._opened
    Board.__init__(board, WIDE, max_current_ma=5.0, max_slots=9, time_to_zero_ms=0, firmware="")
    board._opened = opened


CHANGES = {
    "other limits": (lambda board: setattr(board._gate, "limits", WIDE), "limits"),
    "wider fields": (wider_fields, "limits"),
    "wider whole numbers": (wider_whole_numbers, "limits"),
    "another array": (other_array, "limits"),
    "another gate": (lambda board: setattr(board, "_gate", SafetyGate(WIDE)), "gate"),
    "no gate": (lambda board: delattr(board, "_gate"), "gate"),
    "another proof": (lambda board: setattr(board._gate, "prove", lambda s, t: s), "gate"),
    "another part of it": (lambda board: setattr(board._gate, "_prove_rise", print), "gate"),
    "made again": (made_again, "gate"),
    "the gate's clock": (other_gate_clock, "clock"),
    "its clock": (other_clock, "clock"),
    "another now": (own_now, "clock"),
    "its time": (lambda board: setattr(board, "_time", lambda: None), "clock"),
    "no finger": (lambda board: setattr(board, "on_a_finger", False), "on_a_finger"),
    "send": (lambda board: vars(board).update(send=print), "send"),
    "stop": (lambda board: vars(board).update(stop=print), "stop"),
}  # fmt: skip


@pytest.mark.parametrize("at", ["open", "send", "later", "before"])
@pytest.mark.parametrize("name", CHANGES)
def test_a_driver_that_changes_what_keeps_it_safe_is_refused(name, at):
    change, about = CHANGES[name]
    kind = type("Mine", (Theirs,), {"at": at, "change": staticmethod(change)})
    board = kind(allowed())

    def run():
        if at == "before":
            change(board)
        Board.open(board)
        Board.send(board, sequence(0))
        if at == "later":
            change(board)
        Board.send(board, sequence(1, 240))

    with raises(BoardError, names=about, value="Mine"):
        run()
    assert board.flows == {"open": [], "before": []}.get(at, [0])
    assert board.stops > 0
    # It stays so: nobody opens it again.
    with pytest.raises(BoardError):
        Board.open(board)
    with pytest.raises(BoardError):
        Board.send(board, sequence(2, 240))
    assert max(board.flows, default=0) == 0


@pytest.mark.parametrize("name", ["send", "open", "stop", "close", "halt", "measure", "clock"])
@pytest.mark.parametrize("kind", [Theirs, Board, StreamedBoard])
def test_what_a_class_has_sealed_stays(kind, name):
    for attack in (
        lambda: setattr(kind, name, print),
        lambda: delattr(kind, name),
        lambda: setattr(Theirs(allowed()), name, print),
    ):
        with raises(BoardError, names=name):
            attack()


def test_a_base_beside_it_replaces_nothing():
    beside = type("Beside", (), {"send": print})
    with raises(BoardError, names="send"):
        type("Mine", (beside, Theirs), {})
    with raises(BoardError, names="__bases__"):
        Theirs.__bases__ = (beside, Board)
    with raises(BoardError, names="__class__"):
        Theirs(allowed()).__class__ = beside
    for name in ("__getattribute__", "__setattr__"):
        with raises(BoardError, names=name):
            type("Mine", (Theirs,), {name: lambda board, *_: None})


@pytest.mark.parametrize("name", ["_gate", "_stopped", "_opened", "_halted", "_clock"])
def test_a_property_comes_before_nothing_that_a_board_has(name):
    other = property(lambda board: None, lambda board, value: None)
    with raises(BoardError, names=name):
        type("Mine", (Theirs,), {name: other})
    with raises(BoardError, names=name):
        setattr(Theirs, name, other)


def test_limits_cannot_be_written_into():
    """4.9 mA where 2.43 is allowed."""
    limits = Theirs(allowed())._gate.limits
    for array in (limits.current_ua, limits.charge_pc, limits.felt_ua, limits.faint_ua):
        with pytest.raises(ValueError):
            array[:] = 5000
        with pytest.raises(ValueError):
            array.setflags(write=True)


def test_limits_that_a_driver_writes_into_before_it_hands_them_on(monkeypatch):
    def opener(rest, limits, output):
        object.__setattr__(limits, "current_ma", 4.9)
        return Theirs(limits)

    monkeypatch.setattr("smarttouch.boards.open._driver", lambda url: (opener, ""))
    with raises(BoardError, names="limits", value="Theirs"):
        make_board("theirs:", allowed())


def test_limits_of_another_display_are_no_matter():
    limits = allowed()
    boards = [Theirs(limits), Theirs(limits), Theirs(dataclasses.replace(limits, duty=0.5))]
    for board in boards:
        with board:
            board.send(sequence(0))
            board.send(sequence(1, 60))
    assert [board.flows for board in boards] == [[0, 60]] * 3
