"""Board: adds a safety gate, stop, recovery and a sender thread to a driver."""

import contextlib
import os
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import LATE_NS, Clock, MonotonicClock
from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardFaultError,
    BoardLatchedError,
    BoardRestartedError,
    BoardStoppedError,
    LineLostError,
    OtherDeviceError,
    SequenceLateError,
    SilentBoardError,
)
from smarttouch.base.posix import prioritized
from smarttouch.base.stopping import uninterrupted
from smarttouch.base.wire.port import device_of
from smarttouch.boards import reports
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.impedance import Impedance, measure_by_probes
from smarttouch.boards.reports import LONGEST_REPEAT, BoardReport, Capabilities
from smarttouch.boards.shutdown import enter, leave
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, Ramp, SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence
from smarttouch.stimulation.sequence_limits import Dose

__all__ = ["Board", "BoardReport", "Capabilities"]

FARTHEST_NS = 10_000_000_000  # longest time until a planned start; if longer, the clock is wrong
PROBES = 10  # attempts at each measuring scan, because a busy computer can lose readings
ENDS_WITHIN_S = 3.0  # longest wait for the end of the sender thread
QUEUED_S = 0.5  # longest wait of `send` for an empty queue, in addition to 4 sequence periods
RESTARTS = 3  # attempts to reconnect a lost board
_MOST_VOLTS = 64

Measured = tuple[ScanSequence, NDArray[np.float32]]


@final
class Board:
    """Electrode board that sends only sequences that its safety gate has proved safe.

    Parameters
    ----------
    driver : Driver
    limits : SafetyLimits
        Limits from the profile of the finger.
    output : Output, optional
        Table ``output`` of the profile: kind, scale, wiring.
    clock : Clock, optional
        By default the machine's clock.
    late_ns : int, optional
        Delay after which a sequence is dropped; by default 100 ms.
    on_a_finger : bool
        Whether a finger may be on the board.
    claimed_time : bool
        Whether the gate uses the times stated in sequences; only for boards that no finger can
        touch.
    simulated_time : bool
        Whether the board never waits: time advances by the times stated in sequences.

    Attributes
    ----------
    driver : Driver
    announced : bool
        Whether ``smarttouch stop`` must reach the board while it is open.
    capabilities : Capabilities
        Capabilities of the device, known once the board is open.
    clock : Clock
        Clock of planned starts.
    ramp : Ramp
        Ramp of written sequences, which limits the strength of the next one.
    acknowledged, refused, replaced, dropped_late : int
        How many sequences the board has begun; how many it has refused; how many were replaced by
        a newer one before they were sent; how many were dropped because they were late.
    force_n : float or None
        Finger force, if the board measures it.
    lifted : bool
        Whether the voltages of the last scan show that nothing touches the electrodes.
    notes : list of str
        Messages for the user, shown after the run.
    """

    capabilities: Capabilities

    def __init_subclass__(cls, **_: object) -> None:
        raise BoardError(f"{cls.__name__} inherits from Board, which is final: write a Driver")

    def __init__(
        self,
        driver: Driver,
        limits: SafetyLimits,
        output: Output | None = None,
        *,
        clock: Clock | None = None,
        late_ns: int = LATE_NS,
        on_a_finger: bool = True,
        claimed_time: bool = False,
        simulated_time: bool = False,
    ) -> None:
        if output is not None and output.wiring is not None and not driver.takes_wiring:
            raise BoardError(
                "output.wiring is for boards whose outputs are wired by the user (etactilekit:): "
                "remove it from the profile of this board"
            )
        self.driver = driver
        self.on_a_finger: bool = on_a_finger
        self.announced: bool = on_a_finger or not claimed_time
        self.simulated_time: bool = simulated_time and not self.announced
        self._claimed_time = claimed_time
        self.acknowledged: int = 0
        self.refused: int = 0
        self.replaced: int = 0
        self.dropped_late: int = 0
        self.force_n: float | None = None
        self.lifted: bool = False
        self.notes: list[str] = []
        self._output = output
        self._limits = limits.on(output)
        self.clock: Clock = clock or MonotonicClock()
        # If the gate uses the times stated in sequences, no sequence is late.
        self._late_ns = late_ns if self.announced else 2**62
        self._gate = SafetyGate(self._limits, None if claimed_time else self.clock)
        self.ramp: Ramp = self._gate.ramp
        self._line = Line(self)
        self._stopped = self._line._stopped
        self._halted = self._opened = False
        self._ready = False  # whether the driver can set the device to zero
        self._is_lost = False  # whether the connection is lost
        self._zeroed = False  # whether a stop has set the board to zero
        self._fault_found: BoardFaultError | None = None  # fault that latched the board
        self._opened_by = os.getpid()
        self._number = self._counted = 0
        self._starts: dict[int, tuple[int, int]] = {}
        self._volts: deque[Measured] = deque(maxlen=_MOST_VOLTS)
        self._statistics = reports.HostStatistics(limits.electrodes)
        # The sender thread shares the attributes below.
        self._news = threading.Condition()
        self._waiting: ProvedSequence | None = None
        self._busy = False
        self._failure: BoardError | None = None  # error of the sender thread, for the next `send`
        self._over_s = 0.0  # time at which the written scans end, by time.monotonic
        self._sender: threading.Thread | None = None
        self._ending = threading.Event()

    def __repr__(self) -> str:
        electrodes, state = self._limits.electrodes, "open" if self._opened else "closed"
        return f"Board({type(self.driver).__name__}, {electrodes} electrodes, {state})"

    # -- opening and closing -----------------------------------------------

    def open(self) -> None:
        """Connect to the device and set all electrodes to zero.

        If a finger may be on the board, ``smarttouch stop`` can stop the board during this call.
        Opening waits up to 1 s if recent sequences have used half of the net charge limit.

        Raises
        ------
        BoardStoppedError
            If the board or this program was stopped permanently.
        BoardError
            If the board cannot be opened, or if all displays of this user together could exceed
            `CEILING_USER_MA`.
        """
        self._require_own()
        if self._opened:
            raise BoardError("the board is already open: close it first")
        self._opened_by = os.getpid()
        if (record := reports.find_latch(self.device)) is not None:
            raise BoardLatchedError(
                f"the board ({self.device}) was latched on {record}; have the board checked, then "
                "clear the fault with smarttouch devices clear"
            )
        enter(self)
        try:
            # Reset the ramp. The times of sequences may start at 0 again.
            self._gate.begin_session()
            self._zeroed = False
            self._stopped.clear()
            # Check `_halted` after clearing the event, so that no concurrent `halt` is missed.
            if self._halted:
                self._stopped.set()
            self._line.pause(self._gate.net_rest_ns() / 1e9)
            self._number = self._counted = 0
            self._statistics = reports.HostStatistics(self._limits.electrodes)
            self._starts.clear()
            self._open_driver()
            self._opened = True
            self._line.require_running()
        except BaseException:
            # Ctrl-C can come when the board is already open: `close` then sets it to zero.
            if self._opened:
                self.close()
            else:
                leave(self)
            raise

    def _open_driver(self) -> None:
        try:
            self.capabilities = can = self.driver.open(self._line, replace(self._limits))
            electrodes = self._limits.electrodes
            if not isinstance(can, Capabilities) or can.electrodes != electrodes:
                raise BoardError(
                    f"{type(self.driver).__name__}.open did not return Capabilities with "
                    f"{electrodes} electrodes: use the profile of this board"
                )
            self._line.require_running()
        except BaseException:
            self._close_driver()
            raise
        with self._news:
            self._waiting, self._failure, self._busy = None, None, False
        self._ready, self._is_lost, self._ending = True, False, threading.Event()
        # In simulated time nothing happens between sequences, so no thread is needed.
        if not self.simulated_time:
            self._sender = threading.Thread(
                target=self._serve, args=(self._ending,), name="board sender", daemon=True
            )
            self._sender.start()

    def _close_driver(self) -> None:
        self._ending.set()
        self._drop_waiting()
        if self._sender is not None and self._sender is not threading.current_thread():
            self._sender.join(ENDS_WITHIN_S)
        try:
            self.driver.close()
        finally:
            self._line.disconnect()

    def _recover(self, lost: LineLostError) -> None:
        """Reconnect to a lost device and set it to zero, in up to three attempts. Raises BoardError
        if all fail."""
        self._is_lost = self._line.reopened = True
        self._close_driver()
        for left in reversed(range(RESTARTS)):
            try:
                self._open_driver()
                break
            except BoardStoppedError:
                raise
            except OtherDeviceError as other:
                raise BoardError(f"{lost}; {other}") from None
            except BoardError as again:
                # Try again if the connection failed, or if a silent device may still be starting.
                if not left or not isinstance(again, LineLostError | SilentBoardError):
                    raise lost from None
        # After an interruption the ramp starts at zero intensity again.
        self._gate.restart()

    def close(self) -> None:
        """Set all electrodes to zero and close the board."""
        self._require_own()
        if self._opened:
            self._opened = self._line.reopened = False
            with contextlib.ExitStack() as stack:
                stack.callback(lambda: leave(self, at_zero=self._zeroed))
                stack.callback(setattr, self, "_ready", False)
                stack.callback(self._close_driver)
                self.stop()
            if self._fault_found is not None:
                raise self._fault_found

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, _kind: object, error: object, _trace: object) -> None:
        # Report only the first fault.
        with contextlib.suppress(*[BoardError] * (error is not None)):
            self.close()

    # -- stops and faults --------------------------------------------------

    def stop(self) -> None:
        """Set all electrodes to zero now, from any thread; nothing is sent or measured
        afterwards."""
        self._require_own()
        with uninterrupted():
            try:
                self._line._bar()
            finally:
                self._drop_waiting()
                if self._ready:
                    try:
                        self._line._put_at_zero()
                    except (BoardClosedError, LineLostError):
                        # A board that was lost earlier has stopped, if it has a host timeout.
                        if not self._is_lost or self.capabilities.time_to_zero_ms is None:
                            raise
            self._zeroed = True

    def halt(self) -> None:
        """Stop permanently, from any thread; opening fails from now on."""
        self._halted = True
        self.stop()

    def _drop_waiting(self) -> None:
        """Drop the queued sequence, and wake all waiting threads."""
        with self._news:
            self._waiting = None
            self._news.notify_all()

    @property
    def device(self) -> str | None:
        """Identity under which faults are recorded: USB serial number, else port, else None."""
        return None if self.driver.port is None else device_of(self.driver.port)

    @property
    def budget_ua(self) -> int:
        """Largest total current, µA, that counts toward the user's total; 0 without a finger."""
        return self._limits.total_ua if self.on_a_finger else 0

    # -- sending -----------------------------------------------------------

    def send(self, sequence: ScanSequence, times: int = 1, due_ns: int | None = None) -> int:
        """Let the safety gate prove a sequence safe, then send it.

        Parameters
        ----------
        sequence : ScanSequence
        times : int
            Number of passes; a newer sequence ends them early.
        due_ns : int, optional
            Planned start, by the board's clock; by default now.

        Returns
        -------
        int
            Number of the sequence on the board.

        Raises
        ------
        SafetyError
            If the sequence exceeds a limit; nothing is sent.
        BoardRestartedError
            If the board was lost and is back: start again at intensity 0.
        SequenceLateError
            If this or an earlier sequence was late: start again at intensity 0.
        BoardStoppedError
            If the board was stopped.
        BoardError
            If the board is closed, has another number of electrodes, or was lost.
        """
        if not self._opened or self._opened_by != os.getpid():
            self._require_own("sending")
        if self._stopped.is_set():
            self._line.require_running()
        now_ns, can = self.clock.now_ns(), self.capabilities
        due_ns = due_ns if due_ns is not None and self.announced else now_ns
        if due_ns - now_ns > FARTHEST_NS:
            raise BoardError(
                f"due_ns is {(due_ns - now_ns) / 1e9:.3g} s from now, more than the allowed "
                f"{FARTHEST_NS / 1e9:g} s: compute it from board.clock.now_ns()"
            )
        if isinstance(times, (int, np.integer)) and times > LONGEST_REPEAT:
            raise BoardError(f"times is {times}: give at most {LONGEST_REPEAT}")
        if sequence.recharge_ua is not None and not can.recharges:
            raise BoardError("this board cannot make a recharge phase: send sequences without one")
        proved = self._gate.prove(
            sequence, times, number=self._number + 1, due_ns=due_ns, late_ns=self._late_ns
        )
        if proved.peak_ua > 1000 * can.max_current_ma:
            # Larger counts could overflow in a driver, which could reverse the current.
            range_ma = f"at most {can.max_current_ma:g} mA, not {proved.peak_ua / 1000:g} mA"
            raise BoardError(f"this board makes {range_ma}: reduce limits.current_ma")
        try:
            self._number = proved.number
            if self._failure is not None:
                self._raise_failure()
            (self._queue if can.host_timed else self.driver.write)(proved)
            return proved.number
        except BoardError as error:
            failure = self._not_sent(error)
        raise failure

    def _not_sent(self, error: BoardError) -> BoardError:
        """Return the error to raise for an unsent sequence. Reconnect the board if it was lost."""
        # If the board was stopped, raise BoardStoppedError: the stop is the cause of the error.
        self._line.require_running()
        if isinstance(error, SequenceLateError):
            self.dropped_late += 1
            # After an interruption the ramp starts at zero intensity again.
            self._gate.restart()
        elif isinstance(error, LineLostError):
            self._recover(error)
            self.notes.append(f"{error}; the board was restarted")
            return BoardRestartedError(f"{error}; the board was restarted")
        return error

    def close_level(self) -> None:
        """Reset the ramp: the next sequence must start at zero intensity, as after a lifted
        finger."""
        self._gate.restart()

    def keep_kernels(self, table: KernelTable) -> None:
        """Store the kernels of the next sequences on the board, if it can store kernels.

        Raises
        ------
        BoardError
            If the board is closed, stopped or lost.
        """
        self._require_own("giving it kernels")
        try:
            self.driver.store_kernels(table)
        except LineLostError as lost:
            self._recover(lost)

    def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until all sequences have been delivered, at most ``timeout_s``."""
        deadline_s = time.monotonic() + timeout_s
        with self._news:
            self._news.wait_for(
                lambda: self._is_over or (self._waiting is None and not self._busy), timeout_s
            )
        # A stop may arrive while the driver queries the device.
        with contextlib.suppress(BoardStoppedError):
            while time.monotonic() < deadline_s and self.report().is_busy:
                self._line.pause(0.002)
        if not (self._claimed_time or self.capabilities.acknowledges):
            self._stopped.wait(max(0.0, min(deadline_s, self._over_s) - time.monotonic()))

    # -- the sender thread -------------------------------------------------

    @property
    def _is_over(self) -> bool:
        """Whether the sender thread has failed or the board was stopped."""
        return self._failure is not None or self._stopped.is_set()

    def _raise_failure(self) -> None:
        failure = self._failure
        if isinstance(failure, SequenceLateError):
            self._failure = None
        if failure is not None:
            raise failure

    def _queue(self, proved: ProvedSequence) -> None:
        """Queue a sequence. If the queue stays full too long, replace the sequence in the queue."""
        patience_s = QUEUED_S + 4e-6 * proved.sequence.period_us
        with self._news:
            self._news.wait_for(lambda: self._is_over or self._waiting is None, patience_s)
            self._raise_failure()
            self._line.require_running()
            self.replaced += self._waiting is not None
            self._waiting = proved
            self._news.notify_all()

    @prioritized()
    def _serve(self, ending: threading.Event) -> None:
        """Write queued sequences, and call `Driver.idle` between them."""
        wait_s: float | None = 0.0
        while True:
            with self._news:
                self._busy = False
                self._news.notify_all()
                self._news.wait_for(
                    lambda: self._waiting or ending.is_set() or self._stopped.is_set(), wait_s
                )
                if ending.is_set() or self._stopped.is_set():
                    break
                proved, self._waiting = self._waiting, None
                self._busy = proved is not None
                self._news.notify_all()
            try:
                wait_s = 0.0
                if proved is not None:
                    self.driver.write(proved)
                wait_s = self.driver.idle()
            except SequenceLateError as late:
                # The next `send` raises this error and restarts at zero.
                with self._news:
                    self.dropped_late += 1 + (self._waiting is not None)
                    self._waiting, self._failure = None, self._failure or late
            except BoardStoppedError:
                break
            except Exception as error:
                self._fail(error)
                break
        self._busy = False
        self._drop_waiting()

    def _fail(self, error: Exception) -> None:
        fault = error
        if not isinstance(fault, BoardError):
            fault = BoardError(f"the driver {type(self.driver).__name__} has failed ({error!r})")
            fault.__cause__ = error
        with self._news:
            self._is_lost = self._is_lost or isinstance(fault, LineLostError)
            if self._failure is None or isinstance(self._failure, SequenceLateError):
                self._failure = fault
            self._news.notify_all()
        if not isinstance(fault, LineLostError):
            # Set the board to zero: otherwise it would repeat its last pattern.
            with contextlib.suppress(BoardError):
                self._line._put_at_zero()

    # -- measuring and reports ---------------------------------------------

    def measure(self) -> Impedance:
        """Measure the impedance of each electrode, with small currents.

        Raises
        ------
        BoardStoppedError
            If the board was stopped; all electrodes are at zero.
        BoardError
            If the board is closed, cannot measure, or gives invalid answers.
        """
        self._require_own("measuring")
        self._line.require_running()
        self._gate.restart()
        try:
            self._volts.clear()
            return measure_by_probes(self._probe, self._limits, self._output, self.capabilities)
        finally:
            # Reset the ramp. The times of sequences may start at 0 again.
            self._gate.restart()

    def _probe(self, probe: ScanSequence) -> NDArray[np.float64]:
        """Deliver a measuring scan and return the voltage of each slot, (S,) V."""
        for again in range(PROBES):
            self.send(replace(probe, time_ns=probe.time_ns + again))
            self.drain()
            # A stop may arrive while the scan is delivered.
            self._line.require_running()
            if not probe.slots:
                return np.empty(0)
            measured = [volts for scan, volts in self.take_volts() if scan.time_ns >= probe.time_ns]
            if measured:
                return measured[-1].astype(np.float64)
        raise BoardError(
            f"the board at {self._line.name} did not report the voltages of its electrodes: "
            "measure again"
        )

    def report(self) -> BoardReport:
        """Return the report of delivered sequences. It comes from the device if the device can
        report, otherwise from the host."""
        reported = self.driver.status()
        if reported is not None:
            return reported
        with self._news:
            return self._statistics.report

    def start_of(self, number: int) -> tuple[int, int] | None:
        """Return the start of the sequence that has this number, as returned by `send`.

        Returns
        -------
        (int, int) or None
            Start on `clock`, ns, and on the board's clock, µs since the board was switched on. The
            time on `clock` is too late by the shortest delay of the line. None if the board has not
            reported this start, or has reported many later starts.
        """
        return self._starts.get(number)

    def take_volts(self) -> list[Measured]:
        """Return the voltages measured since the last call.

        Returns
        -------
        list of (ScanSequence, ndarray)
            A delivered sequence, and the voltage of the source at the end of each slot, (S,) V.
        """
        return [self._volts.popleft() for _ in range(len(self._volts))]

    @property
    def net_charge_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode since the board was opened, (E,) pC, positive cathodic."""
        return self._gate.net_pc

    @property
    def dose(self) -> Dose:
        """Dose of current in the skin since the board was opened."""
        return self._gate.dose

    def _require_own(self, use: str = "") -> None:
        """Raise BoardClosedError in a forked process, because its parent owns the board. If ``use``
        (an action that needs an open board) is given, also raise it if the board is closed."""
        if self._opened and self._opened_by != os.getpid():
            raise BoardClosedError(
                f"the board belongs to process {self._opened_by}, which forked this process: make "
                "a new display in this process"
            )
        if use and not self._opened:
            raise BoardClosedError(f"the board is not open: open it before {use}")
