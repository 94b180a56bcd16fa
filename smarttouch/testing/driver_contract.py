"""Contract tests of a driver: subclass `DriverContract` beside yours."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smarttouch.base.errors import BoardClosedError, BoardError, BoardStoppedError, SafetyError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.testing.pulses import ZERO, AtLine, SentPulse, assert_same_pulses, planned_pulses

SECOND = 10**9
UNSAFE = {
    "strong": "current_ma",
    "unbalanced": "balance",
    "long": "pulse_us",
    "often": "rate_hz",
    "intense": "intensity",
    "sudden": "ramp_s",
    "earlier": "time_ns",
}
"""Limits that a sequence of `DriverContract.unsafe_sequence` breaks, by how."""


NewBoard = Callable[[], Board]


class DriverContract:
    """Contract of every driver: subclass it as ``TestMine``, with `make`, `received` and `decode`.

    What the device is sent is compared with what was proved. A scale that is wrong in the driver
    and in `decode` alike is not found by this, but by ``smarttouch calibrate scale``.

    Attributes
    ----------
    electrodes : int
        Of the board that is made.
    cathodic : bool
        Whether it can make cathodic currents; else all are anodic.
    width_us, discharge_us, period_us : int, µs
        Of the sequences that are sent.
    intensity, level_ua : float, int
        The same: as strong as may be without a ramp.
    step_ua, step_us : float, µA, µs
        Steps to which the device rounds currents and times.
    keeps_order : bool
        Whether slots come in the sequence's order; not where the device goes by index.
    counts_passes : bool
        Whether the device makes as many passes as it is sent; not one that scans by itself, again
        and again, until it is sent something else.
    instants : int
        At how many lines of the driver's code a stop comes.
    late_ns : int
        Delay after which a sequence is dropped: long, as the machine may be busy.
    made : Driver
        The last that was made.
    calls : list of (str, tuple)
        Names of the driver's methods that were called, and what with.
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
    late_ns: int = 60 * SECOND
    made: Driver
    calls: list[tuple[str, tuple[Any, ...]]]

    def make(self, limits: SafetyLimits) -> Driver:
        """Return a new driver, not opened yet; all that were made share one device."""
        # Not abstract: pytest could not make the class to run what needs no device.
        raise NotImplementedError("return your driver, for these limits")

    def board(self, driver: Driver, limits: SafetyLimits) -> Board:
        """Return the board of a driver; replace it to give the board another output or clock."""
        # Without a share of the current that all displays may drive together.
        return Board(driver, limits, late_ns=self.late_ns, on_a_finger=False)

    def received(self) -> bytes:
        """Return all that the device has been sent since it was made, once it is there."""
        raise NotImplementedError("return the bytes that your device, or its stand-in, was sent")

    def decode(self, data: bytes) -> list[SentPulse]:
        """Return the pulses that bytes make a device give, in order, repetitions written out.

        `ZERO` is among them wherever all electrodes are put at zero. Write it by the device's
        documents, not by the driver: what both have wrong in the same way is not found.
        """
        raise NotImplementedError("return the pulses that these bytes are, by your own decoder")

    def pulses(self) -> list[SentPulse]:
        """Return what the device has been sent; replace it where that is no bytes."""
        return self.decode(self.received())

    def assert_silent(self) -> None:
        """Fail unless the last that the device was sent is zero, and stays so."""
        before = self.pulses()
        assert before[-1] == ZERO, "the last that the device was sent is not zero"
        time.sleep(2e-6 * self.period_us)
        assert self.pulses() == before, "the device was sent something after it was at zero"

    @pytest.fixture
    def limits(self) -> SafetyLimits:
        """Limits of the finger on the board."""
        return SafetyLimits(self.electrodes, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)

    @pytest.fixture
    def new_board(self, limits: SafetyLimits) -> Callable[[], Board]:
        """Return a maker of boards, whose drivers' calls are kept."""

        def make() -> Board:
            self.made, self.calls = self.make(limits), []
            for name in ("open", "write", "measure", "zero", "close"):
                setattr(self.made, name, self._kept(name, getattr(self.made, name)))
            return self.board(self.made, limits)

        return make

    def _kept(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any) -> Any:
            self.calls.append((name, given))
            return method(*given)

        return called

    def sequence(
        self,
        step: int,
        level_ua: int | None = None,
        electrodes: int | None = None,
        sites: Iterable[int] = range(4),
    ) -> ScanSequence:
        """Return one electrode against all others in each slot; step 0 is silent.

        Parameters
        ----------
        step : int
            Seconds since the start.
        level_ua : int, µA
            Of the one electrode; positive is cathodic, where the board can be.
        electrodes : int
        sites : iterable of int
        """
        level_ua = self.level_ua if level_ua is None else level_ua
        count = electrodes or self.electrodes
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

    def unsafe_sequence(self, how: str, limits: SafetyLimits) -> ScanSequence:
        """Return a sequence for step 1 that breaks a limit in one of the ways of `UNSAFE`."""
        sequence = self.sequence(1)
        if how == "strong":
            return self.sequence(1, level_ua=round(1000 * limits.current_ma) + 100)
        if how == "unbalanced":
            current_ua = sequence.current_ua.copy()
            current_ua[-1, -1] += 1
            return replace(sequence, current_ua=current_ua)
        if how == "long":
            return replace(
                sequence, width_us=np.full_like(sequence.width_us, int(limits.pulse_us) + 1)
            )
        if how == "often":
            return replace(sequence, period_us=round(1e6 / limits.rate_hz) - 1)
        if how == "earlier":
            return replace(sequence, time_ns=0)
        if how == "sudden":
            # As strong as it may be: weak pulses may begin at once.
            peak_ua = int(np.abs(sequence.current_ua).max())
            total_ua = int(sequence.current_ua.clip(0).sum(axis=1).max())
            times = min(limits.full_ua // peak_ua, limits.total_ua // total_ua)
            longest_us = np.full_like(sequence.width_us, limits.width_whole_us)
            sequence = replace(
                sequence, current_ua=max(1, int(times)) * sequence.current_ua, width_us=longest_us
            )
        return replace(sequence, intensity={"intense": 1.1, "sudden": 1.0}[how], time_ns=1)

    def _start(self, board: Board) -> None:
        """Send a silent sequence, then one that goes on for a while."""
        board.send(self.sequence(0))
        board.drain()
        board.send(self.sequence(1), times=1000)

    # -- what is kept ------------------------------------------------------

    def test_it_tells_what_it_can_do(self, new_board: NewBoard) -> None:
        with new_board() as board:
            can = board.capabilities
            assert can.electrodes == self.electrodes
            assert can.time_to_zero_ms is None or 0 <= can.time_to_zero_ms <= 600
            assert all(name and value for name, value in can.describe())
            assert board.report().slots == 0

    def test_what_is_sent_is_what_was_proved(self, new_board: NewBoard) -> None:
        with new_board() as board:
            for step in range(5):
                board.send(self.sequence(step))
                board.drain()
            assert (board.acknowledged, board.refused, board.replaced) == (5, 0, 0)
            assert board.report().violations == 0
            assert board.dose.seconds > 0
        given = [given[0] for name, given in self.calls if name == "write"]
        assert len(given) == 5
        for step, proved in enumerate(given):
            wanted, sequence = self.sequence(step), proved.sequence
            assert (proved.times, sequence.time_ns) == (1, wanted.time_ns)
            assert type(sequence) is ScanSequence
            np.testing.assert_array_equal(sequence.current_ua, wanted.current_ua)
            np.testing.assert_array_equal(sequence.width_us, wanted.width_us)
            assert not sequence.current_ua.flags.writeable

    def test_what_the_device_is_sent_is_what_was_proved(self, new_board: NewBoard) -> None:
        """Each electrode is a site once, all but one rest once, and passes are repeated."""
        every, sent = list(range(self.electrodes)), [(self.sequence(0), 1)]
        with new_board() as board:
            can = board.capabilities
            at_once = min(4, can.max_slots)
            if can.recharges and self.shows_recharges:
                sent.append((self.recharged_sequence(1), 2))
            for first in range(0, self.electrodes, at_once):
                # Backwards, so that no order but the sequence's own does.
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
                # A repetition ends where a newer sequence comes.
                if self.counts_passes:
                    board.send(sequence, times)
                    board.drain(5)
                    time.sleep(1e-6 * sequence.period_us * times)
                else:
                    board.send(sequence, 500)
                    self._wait_for(len(set(wanted)))
            found = [pulse for pulse in self.pulses() if pulse != ZERO]
        if not self.counts_passes:
            found, wanted = list(dict.fromkeys(found)), list(dict.fromkeys(wanted))
        assert_same_pulses(found, wanted, self.step_ua, self.step_us)

    def _wait_for(self, kinds: int) -> None:
        """Wait until a device that scans by itself has been sent so many different pulses."""
        end_s = time.monotonic() + 5
        while len({*self.pulses()} - {ZERO}) < kinds and time.monotonic() < end_s:
            time.sleep(0.02)

    def recharged_sequence(self, step: int) -> ScanSequence:
        """Return a slot with a phase of 2 ms after it, which takes back most of its charge."""
        sequence, recharge_us = self.sequence(step, sites=[0]), 2000
        back_ua = abs(sequence.current_ua[0, -1]) * self.width_us // recharge_us
        recharge_ua = np.where(sequence.current_ua[0] < 0, back_ua, -back_ua).astype(np.int16)
        recharge_ua[0] *= self.electrodes - 1
        return replace(sequence, recharge_ua=recharge_ua, recharge_us=recharge_us)

    def masked_sequence(self, step: int, masked: int) -> ScanSequence:
        """Return a slot of two electrodes against each other beside a masked one."""
        sequence = self.sequence(step, sites=[masked + 1])
        current_ua = np.zeros_like(sequence.current_ua)
        current_ua[0, [masked + 1, masked + 2]] = self.level_ua // 2, -(self.level_ua // 2)
        return replace(sequence, current_ua=current_ua if self.cathodic else -current_ua)

    def test_an_unsafe_sequence_never_leaves(
        self, new_board: NewBoard, limits: SafetyLimits
    ) -> None:
        with new_board() as board:
            board.send(self.sequence(0))
            board.drain()
            before = len(self.calls)
            for how, limit in UNSAFE.items():
                with pytest.raises(SafetyError) as error:
                    board.send(self.unsafe_sequence(how, limits))
                assert error.value.limit == limit, how
                assert self.calls[before:] == [], how

    def test_a_stop_from_another_thread_ends_it(self, new_board: NewBoard) -> None:
        with new_board() as board:
            self._start(board)
            thread = threading.Thread(target=board.stop)
            thread.start()
            thread.join(5)
            assert not thread.is_alive()
            with pytest.raises(BoardStoppedError):
                board.send(self.sequence(2))
            self.assert_silent()

    @pytest.mark.parametrize("what", ["send", "measure"])
    def test_a_stop_at_any_line_of_the_driver(self, new_board: NewBoard, what: str) -> None:
        """It stops from another thread while this one is at that line; nothing comes after."""

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

    def test_nothing_is_measured_after_a_stop(self, new_board: NewBoard) -> None:
        with new_board() as board:
            self._start(board)
            board.stop()
            with pytest.raises(BoardError):
                board.measure()
            assert "measure" not in [name for name, _ in self.calls]
            self.assert_silent()

    def test_one_that_was_halted_is_never_opened(self, new_board: NewBoard) -> None:
        board = new_board()
        board.halt()
        with pytest.raises(BoardStoppedError):
            board.open()
        assert {"open", "write"}.isdisjoint(name for name, _ in self.calls)

    def test_closing_puts_it_at_zero(self, new_board: NewBoard) -> None:
        with new_board() as board:
            self._start(board)
        self.assert_silent()
        assert [name for name, _ in self.calls][-2:] == ["zero", "close"]
        with pytest.raises(BoardClosedError):
            board.send(self.sequence(2))

    def test_an_exception_puts_it_at_zero(self, new_board: NewBoard) -> None:
        broken = RuntimeError("something broke")

        def run() -> None:
            with new_board() as board:
                self._start(board)
                raise broken

        with pytest.raises(RuntimeError) as error:
            run()
        assert error.value is broken
        self.assert_silent()

    def test_a_driver_that_breaks_is_put_at_zero(
        self, new_board: NewBoard, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        broken = RuntimeError("the driver broke")

        def write(*_: object) -> None:
            raise broken

        def run() -> None:
            with new_board() as board:
                self._start(board)
                monkeypatch.setattr(self.made, "write", write)
                board.send(self.sequence(2))
                board.drain()
                board.send(self.sequence(3))

        with pytest.raises((RuntimeError, BoardError)) as error:
            run()
        assert broken in (error.value, error.value.__cause__)
        self.assert_silent()

    def test_another_number_of_electrodes_is_refused(self, new_board: NewBoard) -> None:
        more = self.electrodes + 1
        with new_board() as board, pytest.raises(BoardError) as error:
            board.send(self.sequence(0, electrodes=more))
        assert f"{more}" in str(error.value)
        assert f"{self.electrodes}" in str(error.value)

    def test_impossible_repetitions_are_named(self, new_board: NewBoard) -> None:
        with new_board() as board:
            for times in (0, -1, 65_536):
                with pytest.raises(BoardError) as error:
                    board.send(self.sequence(0), times)
                assert f"{times} " in str(error.value)

    def test_it_can_be_opened_again_and_begins_at_zero(self, new_board: NewBoard) -> None:
        board = new_board()
        board.close()
        for _ in range(2):
            with board:
                with pytest.raises(BoardError):
                    board.open()
                with pytest.raises(SafetyError) as error:
                    board.send(self.sequence(1))
                assert (error.value.limit, error.value.allowed) == ("ramp_s", 0)
                assert error.value.value == pytest.approx(self.intensity)
                board.send(self.sequence(0))
                board.drain()
                board.send(self.sequence(1))
                board.drain()
        board.close()
