"""Contract tests for drivers of boards: subclass `DriverContract` in your tests."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from types import FrameType
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from smarttouch.base.errors import BoardClosedError, BoardError, SafetyError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

SECOND = 10**9
LATE_NS = 60 * SECOND  # delay after which sequences are dropped: long, as the machine may be busy
LOCKED_S = 0.02  # longest time that the driver's thread waits for the action, s
NewBoard = Callable[[], Board]


@dataclass(frozen=True)
class SentPulse:
    """One pulse sent to a device, or `ZERO`, which sets all electrodes to zero.

    Attributes
    ----------
    current_ua : tuple of float, µA
        Current of each electrode, positive cathodic.
    width_us : float, µs
    discharge_us, period_us : float, optional, µs
        Time of the short circuit after the pulse, and period of the sequence. None if the device
        determines the time.
    """

    current_ua: tuple[float, ...]
    width_us: float
    discharge_us: float | None = None
    period_us: float | None = None


ZERO = SentPulse((), 0.0)  # all electrodes are shorted, and earlier commands are dropped


def planned_pulses(sequence: ScanSequence, times: int) -> list[SentPulse]:
    """Return the pulses of all passes of a sequence; a recharge phase counts as one pulse."""
    period_us = float(sequence.period_us)
    one_pass = [
        SentPulse(tuple(map(float, current_ua)), float(width_us), float(discharge_us), period_us)
        for current_ua, width_us, discharge_us in zip(
            sequence.current_ua, sequence.width_us, sequence.discharge_us, strict=True
        )
    ]
    if sequence.recharge_ua is not None:
        current_ua = tuple(map(float, sequence.recharge_ua))
        one_pass.append(SentPulse(current_ua, float(sequence.recharge_us), None, period_us))
    return one_pass * times


def assert_same_pulses(
    found: Sequence[SentPulse], wanted: Sequence[SentPulse], step_ua: float, step_us: float
) -> None:
    """Fail unless pulses are as planned, rounded to the steps of the device, and sum to zero."""
    assert len(found) == len(wanted), f"{len(found)} pulses were sent, {len(wanted)} were planned"
    for number, (pulse, plan) in enumerate(zip(found, wanted, strict=True)):
        message = f"pulse {number} of {len(wanted)}: "
        assert abs(sum(pulse.current_ua)) <= step_ua / 2, message + "currents do not add up to zero"
        for name, flows in vars(pulse).items():
            proved = getattr(plan, name)
            if flows is not None and proved is not None:
                atol = (step_ua if name == "current_ua" else step_us / 2) + 1e-6
                np.testing.assert_allclose(flows, proved, 0, atol, err_msg=message + name)


class AtLine:
    """Context manager that starts an action in a new thread before one line of a driver's code.
    ``number`` is the number of lines that run before this line. Only lines of code in the driver's
    package are counted, except those of `Board`."""

    thread: threading.Thread | None

    def __init__(self, board: Board, number: int, action: Callable[[], object]) -> None:
        kinds = [kind for kind in type(board.driver).__mro__ if issubclass(kind, Driver)]
        self._packages = {_package(kind.__module__) for kind in kinds if kind is not Driver}
        self._number, self._action = number, action
        self.lines: int = 0  # number of executed lines
        self.thread = None  # thread of the action, once started

    def __enter__(self) -> "AtLine":
        self._before = sys.gettrace()
        sys.settrace(self._enter)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(self._before)

    def _enter(self, frame: FrameType, event: str, argument: Any) -> Any:
        name = frame.f_globals.get("__name__", "")
        counts = name != Board.__module__ and _package(name) in self._packages
        return self._count if counts else None

    def _count(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            if self.lines == self._number:
                self.thread = threading.Thread(target=self._action)
                self.thread.start()
                # If the driver holds a lock that the action needs, the action continues later.
                self.thread.join(LOCKED_S)
            self.lines += 1
        return self._count


def _package(module: str) -> str:
    """Return the package of a module. In SmartTouch, it is a subpackage (``smarttouch.boards``)."""
    if module.startswith("smarttouch."):
        return ".".join(module.split(".")[:2])
    return module.rpartition(".")[0] or module


class DriverContract:
    """Contract tests of drivers: subclass as ``TestMine``, with `make`, `received` and `decode`.

    Bytes sent to the device are decoded and compared with the proved sequences. If the driver and
    `decode` share a wrong current scale, only ``smarttouch calibrate scale`` finds the error.

    Attributes
    ----------
    electrodes : int
        Number of electrodes of the board.
    cathodic : bool
        Whether test sequences drive each site as a cathode; if False, as an anode.
    width_us, discharge_us, period_us : int, µs
        Timing of the test sequences.
    intensity, level_ua : float, int
        Intensity and current of the test sequences, low enough to begin without a ramp.
    step_ua, step_us : float, µA, µs
        Steps to which the device rounds currents and times; rounded currents must sum to zero.
    keeps_order : bool
        Whether slots are delivered in the order of the sequence, not by electrode number.
    counts_passes : bool
        Whether the device counts passes; if False, it scans until it receives another command.
    shows_recharges : bool
        Whether `pulses` returns recharge phases, too, if the board can deliver them.
    instants : int
        Number of lines of the driver's code at which a stop is tested.
    made : Driver
        The driver that `make` returned last.
    calls : Mock
        Calls of the driver's methods, with their arguments.
    """

    electrodes = 8
    cathodic = True
    width_us: int = 100
    discharge_us: int = 50
    period_us: int = 10_000
    intensity: float = 0.15
    level_ua: int = 320
    step_ua: float = 1.0
    step_us: float = 1.0
    keeps_order = counts_passes = shows_recharges = True
    instants = 20
    made: Driver
    calls: Mock

    def make(self, limits: SafetyLimits) -> Driver:
        """Return a new closed driver; all drivers of a test share one device."""
        # Not abstract: pytest must create the class for tests that need no device.
        raise NotImplementedError("override make: return your driver, for these limits")

    def board(self, driver: Driver, limits: SafetyLimits) -> Board:
        """Return the board of a driver. Override this method for another output or clock."""
        # No finger touches the board, so its current does not count toward the limit of the total
        # current through the user.
        return Board(driver, limits, late_ns=LATE_NS, on_a_finger=False)

    def received(self) -> bytes:
        """Return all bytes that the device has received so far."""
        raise NotImplementedError("override received: return all bytes sent to the device")

    def decode(self, data: bytes) -> list[SentPulse]:
        """Return the pulses that a device delivers for these bytes, in order, with repetitions.

        Include `ZERO` wherever all electrodes are set to zero. Follow the documentation of the
        device, not the driver: tests cannot find an error that decoder and driver share.
        """
        raise NotImplementedError("override decode: return the pulses that the device delivers")

    def pulses(self) -> list[SentPulse]:
        """Return the pulses sent to the device. Override this if the device receives no bytes."""
        return self.decode(self.received())

    def assert_silent(self) -> None:
        """Fail unless the last command so far sets all electrodes to zero, and the device receives
        no command during the next two periods."""
        before = self.pulses()
        assert before[-1] == ZERO, "the last command does not set all electrodes to zero"
        time.sleep(2e-6 * self.period_us)
        assert self.pulses() == before, "the device received a command after it was set to zero"

    @pytest.fixture
    def limits(self) -> SafetyLimits:
        """Safety limits for the test sequences."""
        return SafetyLimits(self.electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)

    @pytest.fixture
    def new_board(self, limits: SafetyLimits) -> NewBoard:
        """Return a function that makes boards and records the calls of their drivers."""

        def make() -> Board:
            self.made, self.calls = self.make(limits), Mock()
            for name in ("open", "write", "zero", "close"):
                self.calls.attach_mock(Mock(wraps=getattr(self.made, name)), name)
                setattr(self.made, name, getattr(self.calls, name))
            return self.board(self.made, limits)

        return make

    def sequence(
        self, step: int, level_ua: int | None = None, sites: Iterable[int] = range(4)
    ) -> ScanSequence:
        """Return a sequence that drives one electrode against all others in each slot.

        Parameters
        ----------
        step : int
            Time of the sequence, s; at 0 the sequence has no slots.
        level_ua : int, µA
            Current of the electrode, positive cathodic.
        sites : iterable of int
        """
        level_ua = self.level_ua if level_ua is None else level_ua
        count = self.electrodes
        site = np.array(list(sites) if step else [], np.uint16)
        current = np.full((len(site), count), -(level_ua // (count - 1)), np.int16)
        current[np.arange(len(site)), site] = 0
        current[np.arange(len(site)), site] = -current.sum(axis=1)
        column = np.ones(len(site), np.uint16)
        return ScanSequence(
            current if self.cathodic else -current, column * self.width_us,
            column * self.discharge_us, site, self.period_us, self.intensity if step else 0.0,
            step * SECOND,
        )  # fmt: skip

    def _start(self, board: Board) -> None:
        """Send a sequence without slots, then one with many passes."""
        board.send(self.sequence(0))
        board.drain()
        board.send(self.sequence(1), times=1000)

    def test_it_tells_what_it_can_do(self, new_board: NewBoard) -> None:
        with new_board() as board:
            can = board.capabilities
            assert can.electrodes == self.electrodes
            assert can.time_to_zero_ms is None or 0 <= can.time_to_zero_ms <= 600
            assert all(name and value for name, value in can.describe())
            assert board.report().slots == 0

    def test_what_is_sent_is_counted(self, new_board: NewBoard) -> None:
        with new_board() as board:
            for step in range(5):
                board.send(self.sequence(step))
                board.drain()
            assert (board.acknowledged, board.refused, board.replaced) == (5, 0, 0)
            assert board.report().violations == 0
        assert self.calls.write.call_count == 5

    def test_what_the_device_is_sent_is_what_was_proved(self, new_board: NewBoard) -> None:
        """Compare the sent pulses with the proved sequences. The sequences use all electrodes as
        sites, slots of two electrodes, a recharge phase, and repetitions."""
        every, sent = list(range(self.electrodes)), [(self.sequence(0), 1)]
        with new_board() as board:
            can = board.capabilities
            at_once = min(4, can.max_slots)
            if can.recharges and self.shows_recharges:
                sent.append((self.recharged_sequence(1), 2))
            for first in range(0, self.electrodes, at_once):
                # Reverse the order, so that a driver that sorts slots fails.
                sites = every[first : first + at_once][:: -1 if self.keeps_order else 1]
                sent.append((self.sequence(len(sent), sites=sites), 1 + first // at_once % 3))
            if can.output == "weighted":
                for masked in (0, self.electrodes - 3):
                    sent.append((self.masked_sequence(len(sent), masked), 2))
            if len(can.polarities) > 1:
                reversed_one = self.sequence(len(sent))
                sent.append((replace(reversed_one, current_ua=-reversed_one.current_ua), 1))
            wanted = []
            for sequence, times in sent:
                wanted += planned_pulses(sequence, times)
                # A new sequence would end the repetitions, so wait for the last repetition.
                if self.counts_passes:
                    board.send(sequence, times)
                    board.drain(5)
                    time.sleep(1e-6 * sequence.period_us * times)
                else:
                    # A device may drop a sequence if a busy computer is late: send it again.
                    any(self._arrives(board, sequence, ns, len(set(wanted))) for ns in range(3))
            pulses = [pulse for pulse in self.pulses() if pulse != ZERO]
        if not self.counts_passes:
            pulses, wanted = list(dict.fromkeys(pulses)), list(dict.fromkeys(wanted))
        assert_same_pulses(pulses, wanted, self.step_ua, self.step_us)

    def _arrives(self, board: Board, sequence: ScanSequence, later_ns: int, kinds: int) -> bool:
        """Send a sequence; return whether the device receives ``kinds`` different pulses in 5 s."""
        board.send(replace(sequence, time_ns=sequence.time_ns + later_ns), 500)
        end_s = time.monotonic() + 5
        while (few := len({*self.pulses()} - {ZERO}) < kinds) and time.monotonic() < end_s:
            time.sleep(0.02)
        return not few

    def recharged_sequence(self, step: int) -> ScanSequence:
        """Return one slot, and a recharge phase of 2 ms that returns most of the slot's charge."""
        sequence, recharge_us = self.sequence(step, sites=[0]), 2000
        back_ua = abs(sequence.current_ua[0, -1]) * self.width_us // recharge_us
        recharge_ua = np.where(sequence.current_ua[0] < 0, back_ua, -back_ua).astype(np.int16)
        recharge_ua[0] *= self.electrodes - 1
        return replace(sequence, recharge_ua=recharge_ua, recharge_us=recharge_us)

    def masked_sequence(self, step: int, masked: int) -> ScanSequence:
        """Return one slot that drives the two electrodes after ``masked`` against each other."""
        sequence = self.sequence(step, sites=[masked + 1])
        current_ua = np.zeros_like(sequence.current_ua)
        current_ua[0, [masked + 1, masked + 2]] = self.level_ua // 2, -(self.level_ua // 2)
        return replace(sequence, current_ua=current_ua if self.cathodic else -current_ua)

    @pytest.mark.parametrize("what", ["send", "measure"])
    def test_a_stop_at_any_line_of_the_driver(self, new_board: NewBoard, what: str) -> None:
        """Stop the board from another thread while a line runs. Then nothing more may be sent."""

        def call(board: Board) -> None:
            with contextlib.suppress(BoardError, SafetyError):
                board.send(self.sequence(1), times=2) if what == "send" else board.measure()

        with new_board() as board:
            board.send(self.sequence(0))
            with AtLine(board, -1, board.stop) as counted:
                call(board)
        for instant in range(min(self.instants, counted.lines)):
            number = instant * counted.lines // min(self.instants, counted.lines)
            with new_board() as board:
                board.send(self.sequence(0))
                board.drain()
                with AtLine(board, number, board.stop) as there:
                    call(board)
                if there.thread is not None:
                    there.thread.join(5)
                    assert not there.thread.is_alive()
                    self.assert_silent()

    @pytest.mark.parametrize("breaks", [False, True], ids=["closed", "broken"])
    def test_closing_puts_it_at_zero(self, new_board: NewBoard, breaks: bool) -> None:
        with contextlib.suppress(ZeroDivisionError), new_board() as board:
            self._start(board)
            if breaks:
                raise ZeroDivisionError
        self.assert_silent()
        assert [call[0] for call in self.calls.mock_calls[-2:]] == ["zero", "close"]
        with pytest.raises(BoardClosedError):
            board.send(self.sequence(2))

    def test_it_can_be_opened_again_and_begins_at_zero(self, new_board: NewBoard) -> None:
        board = new_board()
        for _ in range(2):
            with board:
                with pytest.raises(SafetyError) as error:
                    board.send(self.sequence(1))
                assert (error.value.limit, error.value.allowed) == ("ramp_s", 0)
                board.send(self.sequence(0))
                board.drain()
                board.send(self.sequence(1))
                board.drain()
