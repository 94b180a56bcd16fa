"""The watch reports unsafe sequences that a gate accepts, and unsafe pulses that boards deliver."""

from dataclasses import replace

import pytest

from smarttouch.boards.board import Board
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.stimulation.safety_gate import Ramp, SafetyGate, SafetyLimits

from ..support.scans import unproved
from . import watch
from .bounds import Bounds
from .gate_under_test import ManualClock
from .short_sequences import pair, sequence

LIMITS = SafetyLimits(4, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)
SILENT = sequence([], intensity=0.0, time_ns=0)


def prove_all(gate, sequence, times=1, **_):
    """Accept any sequence, as a faulty gate would."""
    return unproved(sequence, times, session=gate.session, strength_ppb=1)


@pytest.fixture
def blind(safety_watch):
    """Let gates accept every sequence. Return a watch that replaces the usual one."""
    safety_watch.on = False
    blinded = watch.Watch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SafetyGate, "prove", prove_all)
        patch.setattr(Ramp, "permits", lambda *_: True)
        inner = blinded.installed()
        yield blinded
        inner.undo()


def test_what_a_gate_should_not_have_accepted(blind):
    gate = SafetyGate(LIMITS, ManualClock())
    gate.check(SILENT)
    assert blind.take() == []
    gate.check(sequence(pair(3001)))
    (broken,) = blind.take()
    assert broken.endswith(", which breaks current, intensity, ramp")


@pytest.mark.parametrize("taken", [False, True])
def test_a_simulated_board(blind, taken, monkeypatch):
    """Pulses are judged when `take_pulses` returns them; the rest when the board is closed."""
    # With a ramp, or with the limits of the watch, the board itself would refuse the pulse.
    monkeypatch.setattr("smarttouch.emulator.link_board_limits.RAMP_MS", 0)
    wider = replace(LIMITS, current_ma=4.0, full_ma=4.0)
    vars(wider)[watch.OF_PROFILE] = Bounds.of_limits(LIMITS)
    driver = SimulatedDriver("", wider)
    own = {"on_a_finger": False, "claimed_time": True, "simulated_time": True}
    with Board(driver, wider, **own) as board:
        board.send(SILENT)
        board.send(sequence(pair(3500)))
        blind.take()
        assert not taken or len(driver.take_pulses()[0]) == 1
        assert len(blind.take()) == taken
    assert len(blind.take()) == (not taken)
