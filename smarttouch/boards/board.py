"""A display board: its safety gate, and all that keeps what its driver sends safe."""

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
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.probe_scans import measure_by_probes
from smarttouch.boards.reports import (
    LONGEST_REPEAT,
    BoardReport,
    Capabilities,
    HostStatistics,
    Impedance,
    SequenceStart,
    find_latch,
    latch,
)
from smarttouch.boards.shutdown import enter, leave
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, Ramp, SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence
from smarttouch.stimulation.sequence_limits import Dose

__all__ = ["Board", "BoardReport", "Capabilities"]

FARTHEST_NS = 10_000_000_000  # planned starts farther ahead than this are of another clock
PROBES = 10  # attempts at a measuring scan: on a busy computer its reading may be lost
ENDS_WITHIN_S = 3.0  # of the sender thread
QUEUED_S = 0.5  # time, beside four periods, after which a queued sequence is replaced
RESTARTS = 3  # attempts to restart a board after its line was lost
_MOST_VOLTS = 64

Measured = tuple[ScanSequence, NDArray[np.float32]]


@final
class Board:
    """A display board, which sends only what its safety gate has proved.

    Parameters
    ----------
    driver : Driver
        Of the device.
    limits : SafetyLimits
        From the profile of the finger on the board.
    output : Output, optional
        Output section of the profile: kind, scale, wiring.
    clock : Clock, optional
        The machine's if not given.
    late_ns : int, optional
        Delay after which a sequence is not sent any more: 100 ms if not given.
    on_a_finger : bool
        Whether a finger may be on it.
    claimed_time : bool
        Whether the gate takes the time that sequences state: for boards without a finger.
    simulated_time : bool
        Whether time also passes only as they state it, without waiting.

    Attributes
    ----------
    driver : Driver
    announced : bool
        Whether ``smarttouch stop`` must reach it while it is open.
    capabilities : Capabilities
        Of the device; known once the board is open.
    clock : Clock
        Of planned sequences.
    ramp : Ramp
        Of what was written: it says how strong a sequence may be planned.
    acknowledged, refused, replaced, dropped_late : int
        Number of sequences that the board has begun to deliver; that it has refused; that a newer
        one replaced before they were sent; that were not sent because they were too late.
    force_n : float or None
        Finger force, if the board measures it.
    lifted : bool
        Whether nothing touches the electrodes, by the voltages of the last scan.
    notes : list of str
        What the user should know after the run.
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
                "remove it from the profile of this one"
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
        # Waits for a deadline need to be exact only where the host times the pulses.
        self.clock: Clock = clock or MonotonicClock()
        # By the time that sequences state, nothing is late.
        self._late_ns = late_ns if self.announced else 2**62
        self._gate = SafetyGate(self._limits, None if claimed_time else self.clock)
        self.ramp: Ramp = self._gate.ramp
        self._line = Line(self)
        self._stopped = self._line._stopped
        self._halted = self._opened = False
        self._ready = False  # whether the driver can put the device at zero
        self._is_lost = False  # whether the connection was lost, and is not back
        self._zeroed = False  # whether a stop has put the board at zero
        self._fault_found: BoardFaultError | None = None  # fault that latched the board
        self._opened_by = os.getpid()
        self._number = self._counted = 0
        self._starts: dict[int, SequenceStart] = {}
        self._volts: deque[Measured] = deque(maxlen=_MOST_VOLTS)
        self._statistics = HostStatistics(limits.electrodes)
        # What the sender thread and the others share.
        self._news = threading.Condition()
        self._waiting: ProvedSequence | None = None
        self._busy = False
        self._failure: BoardError | None = None  # that the next call raises
        self._over_s = 0.0  # end of the scans that were written last, by time.monotonic
        self._sender: threading.Thread | None = None
        self._ending = threading.Event()

    def __repr__(self) -> str:
        electrodes, state = self._limits.electrodes, "open" if self._opened else "closed"
        return f"Board({type(self.driver).__name__}, {electrodes} electrodes, {state})"

    # -- opening and closing -----------------------------------------------

    def open(self) -> None:
        """Connect, shake hands, and put all electrodes at zero.

        From before this begins, other processes can stop a board that a finger may be on. It waits
        up to a second where earlier sequences leave too little room for net current.

        Raises
        ------
        BoardStoppedError
            If the board, or this program, was stopped for good.
        BoardError
            If the displays of this user could drive more current together than
            `CEILING_USER_MA`, and whatever keeps the board from opening.
        """
        self._require_own()
        if self._opened:
            raise BoardError("the board is open already: close it first")
        self._opened_by = os.getpid()
        if (record := find_latch(self.device)) is not None:
            raise BoardLatchedError(
                f"the board ({self.device}) is latched since {record}; have it checked, then clear "
                "it with smarttouch devices clear"
            )
        enter(self)
        try:
            # A new run starts from zero intensity, and its time may start again.
            self._gate.begin_session()
            self._zeroed = False
            self._stopped.clear()
            # In this order: a halt from another thread is seen here or comes later.
            if self._halted:
                self._stopped.set()
            self._line.pause(self._gate.net_rest_ns() / 1e9)
            self._number = self._counted = 0
            self._statistics = HostStatistics(self._limits.electrodes)
            self._starts.clear()
            self._open_driver(again=False)
            self._opened = True
            self._line.require_running()
        except BaseException:
            # Ctrl-C may come when it is open already; and only whoever closes it withdraws it.
            if self._opened:
                self.close()
            else:
                leave(self)
            raise

    def _open_driver(self, *, again: bool) -> None:
        self._line.reopened = again
        try:
            self.capabilities = can = self.driver.open(self._line, replace(self._limits))
            electrodes = self._limits.electrodes
            if not isinstance(can, Capabilities) or can.electrodes != electrodes:
                raise BoardError(
                    f"{type(self.driver).__name__}.open does not return Capabilities of a board "
                    f"of {electrodes} electrodes: use the profile of this board"
                )
            self._line.require_running()
        except BaseException:
            self._close_driver()
            raise
        with self._news:
            self._waiting, self._failure, self._busy = None, None, False
        self._ready, self._is_lost, self._ending = True, False, threading.Event()
        # By simulated time nothing is due between sequences.
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
        """Connect again to a lost device, at zero, up to three times; raise if that fails."""
        self._is_lost = self._line.reopened = True
        self._close_driver()
        for left in reversed(range(RESTARTS)):
            try:
                self._open_driver(again=True)
                break
            except BoardStoppedError:
                raise
            except OtherDeviceError as other:
                raise BoardError(f"{lost}; {other}") from None
            except BoardError as again:
                # The line may be lost again meanwhile.
                if not left or not isinstance(again, LineLostError | SilentBoardError):
                    raise lost from None
        # Nothing was delivered for a while: what comes next begins at zero.
        self._gate.restart()

    def close(self) -> None:
        """Put all electrodes at zero and close the board."""
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
        # The first fault is the one to report.
        with contextlib.suppress(*[BoardError] * (error is not None)):
            self.close()

    # -- stops and faults --------------------------------------------------

    def stop(self) -> None:
        """Put all electrodes at zero now, from any thread; nothing is sent or measured after."""
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
                        # Where silence is zero, only the first loss needs a report.
                        if not self._is_lost or self.capabilities.time_to_zero_ms is None:
                            raise
            self._zeroed = True

    def halt(self) -> None:
        """Stop for good, from any thread; a board that is being opened fails to open."""
        self._halted = True
        self.stop()

    def _drop_waiting(self) -> None:
        """Drop the sequence that waits for the sender thread, and wake threads that wait."""
        with self._news:
            self._waiting = None
            self._news.notify_all()

    def _latch(self, reason: str) -> BoardFaultError:
        """Put the board at zero for good and record its fault; return the error to raise."""
        if self._fault_found is not None:
            return self._fault_found
        self._fault_found = BoardFaultError(
            f"{reason}: the board is at zero and latched; have it checked, then clear it with "
            "smarttouch devices clear"
        )
        with contextlib.suppress(BoardError):
            self.halt()
        if self.device is not None:
            latch(self.device, reason)
        return self._fault_found

    @property
    def device(self) -> str | None:
        """Identity that its faults are recorded by: USB serial number, else port; or None."""
        return None if self.driver.port is None else device_of(self.driver.port)

    @property
    def budget_ua(self) -> int:
        """Its share of the current that all displays of a user may drive together, µA."""
        return self._limits.total_ua if self.on_a_finger else 0

    # -- sending -----------------------------------------------------------

    def send(self, sequence: ScanSequence, times: int = 1, due_ns: int | None = None) -> int:
        """Validate a sequence by the safety gate, then send it.

        It is delivered ``times`` times, one period after another, unless a newer one comes.

        Parameters
        ----------
        sequence : ScanSequence
        times : int
        due_ns : int, optional
            When it was planned to start, by the board's clock; now if not given.

        Returns
        -------
        int
            The number of the sequence on the board.

        Raises
        ------
        SafetyError
            If it breaks a limit; nothing is sent.
        BoardRestartedError
            If the board was lost and is back: begin again at intensity 0.
        SequenceLateError
            If it, or one before it, was too late to be sent: begin again at intensity 0.
        BoardStoppedError
            If the board was stopped.
        BoardError
            If the board is closed, of another size, or gone.
        """
        if not self._opened or self._opened_by != os.getpid():
            self._require_own("sending")
        if self._stopped.is_set():
            self._line.require_running()
        now_ns, can = self.clock.now_ns(), self.capabilities
        due_ns = due_ns if due_ns is not None and self.announced else now_ns
        if due_ns - now_ns > FARTHEST_NS:
            raise BoardError(
                f"due_ns is {(due_ns - now_ns) / 1e9:.3g} s from now, and at most "
                f"{FARTHEST_NS / 1e9:g} s are possible: give a time by board.clock.now_ns()"
            )
        if isinstance(times, int | np.integer) and times > LONGEST_REPEAT:
            raise BoardError(f"{times} repetitions are not possible: at most {LONGEST_REPEAT}")
        if sequence.recharge_ua is not None and not can.recharges:
            raise BoardError(
                "the sequence ends with a recharge phase, and this board makes none: leave it out"
            )
        proved = self._gate.prove(
            sequence, times, number=self._number + 1, due_ns=due_ns, late_ns=self._late_ns
        )
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
        """Return the error to raise for a sequence that was not sent, at zero."""
        # On a stopped board any failure is due to the stop.
        self._line.require_running()
        if isinstance(error, SequenceLateError):
            self.dropped_late += 1
            # Nothing was delivered for a while: what comes next begins at zero.
            self._gate.restart()
        elif isinstance(error, LineLostError):
            self._recover(error)
            self.notes.append(f"{error}: restarted")
            return BoardRestartedError(f"{error}, and was restarted")
        return error

    def close_level(self) -> None:
        """Close the intensity level: what comes next begins at zero, as after a lifted finger."""
        self._gate.restart()

    def keep_kernels(self, table: KernelTable) -> None:
        """Give the board the kernels of the sequences to come, if it keeps any.

        Raises
        ------
        BoardError
            If it is closed, stopped or gone.
        """
        self._require_own("giving it kernels")
        try:
            self.driver.store_kernels(table)
        except LineLostError as lost:
            self._recover(lost)

    def drain(self, timeout_s: float = 1.0) -> None:
        """Wait until all sequences have been delivered, or the time is over."""
        deadline_s = time.monotonic() + timeout_s
        with self._news:
            self._news.wait_for(
                lambda: self._is_over or (self._waiting is None and not self._busy), timeout_s
            )
        # A stop may come while the driver asks its device.
        with contextlib.suppress(BoardStoppedError):
            while time.monotonic() < deadline_s and self.report().is_busy:
                self._line.pause(0.002)
        if not (self._claimed_time or self.capabilities.acknowledges):
            self._stopped.wait(max(0.0, min(deadline_s, self._over_s) - time.monotonic()))

    # -- the sender thread -------------------------------------------------

    @property
    def _is_over(self) -> bool:
        """Whether nothing is sent any more."""
        return self._failure is not None or self._stopped.is_set()

    def _raise_failure(self) -> None:
        failure = self._failure
        if isinstance(failure, SequenceLateError):
            self._failure = None
        if failure is not None:
            raise failure

    def _queue(self, proved: ProvedSequence) -> None:
        """Let the sender thread write a sequence; a newer one replaces one that waits."""
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
        """Write queued sequences, and let the driver do what it does between them."""
        wait_s: float | None = 0.0
        proved: ProvedSequence | None = None

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
                # The next `send` reports it and restarts at zero.
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
            # Its pattern would be shown on with nobody to end it.
            with contextlib.suppress(BoardError):
                self._line._put_at_zero()

    # -- measuring and reports ---------------------------------------------

    def measure(self) -> Impedance:
        """Measure the impedance of every electrode, with small currents.

        Raises
        ------
        BoardStoppedError
            If the board was stopped, before or meanwhile: all electrodes are at zero.
        BoardError
            If the board is closed, cannot measure, or gives an invalid answer.
        """
        self._require_own("measuring")
        self._line.require_running()
        self._gate.restart()
        try:
            self.take_volts()
            return measure_by_probes(self._probe, self._limits, self._output, self.capabilities)
        finally:
            # What comes next begins at zero, and its time may start again.
            self._gate.restart()

    def _probe(self, probe: ScanSequence) -> NDArray[np.float64]:
        """Deliver a scan and return its voltages."""
        for again in range(PROBES):
            self.send(replace(probe, time_ns=probe.time_ns + again))
            self.drain()
            # A stop may come while the last one is delivered.
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
        """Return the report of what was delivered: the device's own, else the host's."""
        reported = self.driver.status()
        if reported is not None:
            return reported
        with self._news:
            return self._statistics.report

    def start_of(self, number: int) -> SequenceStart | None:
        """Return when a sequence began, by the number that `send` returned.

        None before the board has reported it, some seconds later, and for boards that never do.
        """
        return self._starts.get(number)

    def take_volts(self) -> list[Measured]:
        """Return the voltages measured since the last call.

        Returns
        -------
        list of (ScanSequence, ndarray)
            A sequence that was delivered, and the voltage its source needed at
            the end of each slot, (S,) V.
        """
        volts = []
        while self._volts:
            volts.append(self._volts.popleft())
        return volts

    @property
    def net_charge_pc(self) -> NDArray[np.int64]:
        """Net charge of each electrode since the board was opened, (E,) pC, positive cathodic."""
        return self._gate.net_pc

    @property
    def dose(self) -> Dose:
        """Dose of current in the skin since the board was opened."""
        return self._gate.dose

    def _require_own(self, use: str = "") -> None:
        """Raise in a forked process, where the board and its line are its parent's, and before a
        use for which the board must be open."""
        if self._opened and self._opened_by != os.getpid():
            raise BoardClosedError(
                f"process {self._opened_by} has the board open, and a process that it forked may "
                "not use it: make a display here"
            )
        if use and not self._opened:
            raise BoardClosedError(f"the board is not open: open it before {use}")
