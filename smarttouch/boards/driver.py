"""What a driver of a device implements, and the line by which it reaches the device."""

import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardFaultError,
    BoardStoppedError,
    LineLostError,
    SafetyError,
    SequenceLateError,
)
from smarttouch.base.stopping import uninterrupted
from smarttouch.base.wire.port import (
    LINE_ERRORS,
    Port,
    UsbIdentity,
    identity_of,
    open_port,
    read_some,
    reason,
    reopen_port,
    write_before,
)
from smarttouch.boards.reports import BoardReport, Capabilities, SequenceStart
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence, ScanTiming

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

__all__ = ["Driver", "Line"]

PIECE = 4096  # bytes written at once: a stop waits for one piece, not for a whole packet
WRITE_S = 0.6  # longest time that a stop waits for one write: ports give up after .5 s
BLOCKED_S = 1.0  # longest time that zero waits for a write that does not end
RECOVER_S = 3.0  # time to wait for a lost port
_MOST_STARTS = 256


class Driver(ABC):
    """Translator between a `Board` and one kind of device.

    The board owns the safety gate, ramp, clock, stop, sender thread and recovery. It calls the
    methods below, and everything that a driver sends goes through the `Line` that `open` receives.
    A driver reports what it finds out to the line. It needs no lock, no thread and no clock.

    Parameters of a driver that is opened by a URL are the text after the colon, the limits of the
    finger (a copy), the output section of the profile or None, and options by keyword.
    """

    default_profile: ClassVar[str] = DEFAULT_PROFILE
    """Name of the profile that goes with such a device."""
    takes_wiring: ClassVar[bool] = False
    """Whether the user wires the outputs, so that a profile may have ``output.wiring``."""
    keeps_kernels: ClassVar[bool] = False
    """Whether the device can store kernels, so that slots should be sums of them."""
    timing: ScanTiming = ScanTiming()
    """Scan timing fixed by the device; known before it is opened."""
    port: str | None = None
    """Name of the device's port, by which faults are recorded; None if it has none."""

    @abstractmethod
    def open(self, line: "Line", limits: SafetyLimits) -> Capabilities:
        """Connect, check that it is the right device, and put all electrodes at zero.

        It is called again after the connection was lost, with ``line.reopened`` set.

        Parameters
        ----------
        line : Line
            The way to the device; keep it.
        limits : SafetyLimits
            A copy, for the device's firmware and for bounds of counts.

        Raises
        ------
        BoardError
            If it is not this device, or does not answer.
        """

    @abstractmethod
    def write(self, proved: ProvedSequence) -> None:
        """Send a sequence to the device, by `Line.write` or within `Line.current`.

        Where the host times the passes (`Capabilities.host_timed`), this lasts as long as they do,
        and returns early once `Line.has_newer`. An error is raised by the next `Board.send` then.
        """

    @abstractmethod
    def zero(self) -> None:
        """Put all electrodes at zero, from any thread and at any instant, also within `write`.

        Raises
        ------
        BoardError
            If it is not certain that all electrodes are at zero.
        """

    def close(self) -> None:  # noqa: B027, optional for drivers
        """Release what `open` took, also where `open` has failed; the board closes the line."""

    def idle(self) -> float | None:
        """Send heartbeats and read answers between writes, in the board's sender thread.

        It is called once the device is open, and after each `write` of that thread.

        Returns
        -------
        float or None
            Seconds after which to call it again; None if not before the next write.
        """
        return None

    def store_kernels(self, table: KernelTable) -> None:  # noqa: B027, optional for drivers
        """Give the device the kernels of the sequences to come."""

    def status(self) -> BoardReport | None:
        """Return the device's own report of what it delivered; None to use the host's."""
        return None


class Line:
    """Line of one board to its device: the only way by which a driver reaches it.

    It holds the lock of `Board.stop` while it writes, refuses sequences that are late or rise too
    fast, and after a stop refuses everything that `Driver.zero` does not write.

    Attributes
    ----------
    board : Board
        The driver counts in its ``refused`` and ``replaced``, sets its ``force_n``, and appends to
        its ``notes``.
    name : str
        Name of the connected port.
    reopened : bool
        Whether the connection was lost and is opened again: `connect` then waits for the same
        device.
    now_ns : callable
        Returns the time by the board's clock.
    identity : UsbIdentity or None
        USB identity of the device; None if it has none.
    """

    def __init__(self, board: "Board") -> None:
        self.board: Board = board
        self.name: str = ""
        self.reopened: bool = False
        self.now_ns: Callable[[], int] = board.clock.now_ns
        self.identity: UsbIdentity | None = None
        self._port: Port | None = None
        self._stopped = threading.Event()
        # Reentrant: a program's own signal handler may stop while its thread is writing.
        self._lock, self._dialogue = threading.RLock(), threading.RLock()
        self._zeroing: list[int] = []  # threads that write zero, once for each of its blocks

    # -- the connection ----------------------------------------------------

    def connect(
        self, name: str, wrap: Callable[[Port], Port] = lambda port: port, baudrate: int = 921600
    ) -> None:
        """Open a port, or wait until it is back if the connection was lost.

        Parameters
        ----------
        name : str
            A device, ``tcp://HOST:PORT``, or any URL that pyserial knows.
        wrap : callable
            Returns the port to use in place of the open one, such as that of a watchdog.
        baudrate : int

        Raises
        ------
        BoardError
            If it cannot be opened.
        OtherDeviceError
            If another device is there now.
        """
        if self.reopened:
            port = reopen_port(name, RECOVER_S, self.identity, self.pause, baudrate)
        else:
            port = open_port(name, baudrate)
            self.identity = identity_of(port)
        self.name, self._port = name, wrap(port)

    def disconnect(self) -> None:
        """Close the port, if one is open."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                port.close()

    # -- writing -----------------------------------------------------------

    def write(self, data: bytes, proved: ProvedSequence | None = None) -> None:
        """Write bytes to the port.

        Parameters
        ----------
        data : bytes
        proved : ProvedSequence, optional
            The sequence that they let the device deliver; None for bytes that cause no current.

        Raises
        ------
        SequenceLateError
            If it is too late for the sequence, or its current would rise too fast.
        BoardStoppedError
            If the board was stopped, and this is not called by `Driver.zero`.
        LineLostError
            If the connection is lost.
        """
        with self.current(proved), self._open_port("cannot be written to") as port:
            if proved is None:
                port.write(data[:PIECE])
            elif not write_before(port, data[:PIECE], proved.write_before_ns, self.now_ns):
                raise self.late()
            for at in range(PIECE, len(data), PIECE):
                self.require_running()
                port.write(data[at : at + PIECE])

    @contextlib.contextmanager
    def current(self, proved: ProvedSequence | None = None) -> Iterator[None]:
        """Hold the lock of `Board.stop` for a write to a device that is not a port; arguments and
        errors as of `write`. A sequence whose block has ended counts as written."""
        board, begun, zeroing = self.board, False, threading.get_ident() in self._zeroing
        # Signals are deferred for boards that a stop must reach.
        with uninterrupted() if board.announced else contextlib.nullcontext():
            if not self._lock.acquire(timeout=BLOCKED_S if zeroing else -1):
                raise self.lost("is blocked: check the cable")
            try:
                if self._stopped.is_set():
                    self.require_running()
                if proved is not None:
                    if type(proved) is not ProvedSequence:
                        kind = type(board.driver).__name__
                        raise BoardError(f"{kind} sends what the gate has not proved")
                    if proved.session != board._gate.session:
                        raise BoardStoppedError("the board was closed before this: begin at zero")
                    permits = board._gate.ramp.permits
                    if self.now_ns() > proved.write_before_ns or not permits(
                        proved.strength_ppb, proved.sequence.time_ns
                    ):
                        raise self.late()
                begun = True
                yield
                if proved is not None:
                    board._gate.note(proved)
                    can = board.capabilities
                    passes = 1 if can.host_timed else proved.times
                    board._over_s = time.monotonic() + passes * proved.sequence.period_us / 1e6
                    # What was written in parts counts once.
                    if not (can.acknowledges or can.host_timed or proved.number == board._counted):
                        self.delivered(proved, proved.times)
            finally:
                self._lock.release()
                if begun and self._stopped.is_set() and not zeroing:
                    # The stop may not have waited for this write.
                    self._put_at_zero()

    def later(self, proved: ProvedSequence, due_ns: int) -> ProvedSequence:
        """Return a proved sequence for a later start, by `now_ns`: a repetition that the host
        times, or a sequence that waited for its turn on the device.

        Raises
        ------
        SequenceLateError
            If that is later than repetitions and turns can explain.
        """
        try:
            return self.board._gate.repeated(proved, due_ns)
        except SafetyError:
            raise self.late() from None

    # -- reading -----------------------------------------------------------

    def read(self, count: int, within_s: float) -> bytes:
        """Return as many bytes as come in time, at most ``count``."""
        with self._open_port("has vanished") as port:
            port.timeout = within_s
            return bytes(port.read(count))

    def ask(
        self, data: bytes, count: int, within_s: float, proved: ProvedSequence | None = None
    ) -> bytes:
        """Write bytes and return the answer, at most ``count`` bytes; no other question of any
        thread comes between. The bytes deliver a sequence if one is given, as those of `write`."""
        with self._dialogue:
            self.discard_input()
            self.write(data, proved)
            return self.read(count, within_s)

    def read_some(self) -> bytes:
        """Return what has come; waits a moment for the first byte."""
        with self._open_port("has vanished") as port:
            if (data := read_some(port)) is None:
                note = f"another program reads from {self.name}: close it (ModemManager or a "
                note += "serial monitor?)"
                self.board.notes += [note] * (note not in self.board.notes)
                # Whatever the port says: this thread may have priority over all others.
                time.sleep(0.001)
            return data or b""

    def discard_input(self) -> None:
        """Drop what has come and was not read."""
        with self._open_port("has vanished") as port:
            port.reset_input_buffer()

    @contextlib.contextmanager
    def _open_port(self, what: str) -> Iterator[Port]:
        """Lend the port; raise LineLostError if it fails."""
        if (port := self._port) is None:
            raise BoardClosedError("the board is not connected: open it first")
        try:
            yield port
        except LINE_ERRORS as error:
            raise self.lost(f"{what} ({reason(error)})") from None

    # -- time and stops ----------------------------------------------------

    def wait_until(self, time_ns: int) -> None:
        """Wait until a time of the board's clock; raise if the board is stopped meanwhile."""
        self.board.clock.wait_until(time_ns, self._stopped)
        self.require_running()

    def pause(self, seconds: float) -> None:
        """Wait; raise if the board is stopped meanwhile."""
        if threading.get_ident() in self._zeroing:
            time.sleep(seconds)
        else:
            self._stopped.wait(seconds)
            self.require_running()

    @property
    def is_stopped(self) -> bool:
        """Whether writes are refused; never within `Driver.zero`."""
        return self._stopped.is_set() and threading.get_ident() not in self._zeroing

    def require_running(self) -> None:
        """Raise BoardStoppedError if the board was stopped, but not within `Driver.zero`."""
        if self._stopped.is_set() and threading.get_ident() not in self._zeroing:
            if self.board._fault_found is not None:
                raise self.board._fault_found
            again = "open a new display" if self.board._halted else "open it again"
            raise BoardStoppedError(
                f"the board was stopped, all electrodes are at zero: {again} before sending"
            )

    def has_newer(self) -> bool:
        """Return whether a newer sequence waits, which ends the repetitions of this one."""
        return self.board._waiting is not None

    def lost(self, what: str) -> LineLostError:
        """Return the error of a lost connection, such as ``lost("does not answer")``."""
        can, then = getattr(self.board, "capabilities", None), ""
        # A port that is shared with a watchdog tells whether that has put the board at zero.
        if can is not None and not getattr(self._port, "at_zero", False):
            then = "; the board goes on with its last pattern: lift the finger, then switch it off"
            if can.time_to_zero_ms is not None:
                then = f"; it shorts all electrodes within {can.time_to_zero_ms:g} ms of silence"
        return LineLostError(f"the board at {self.name} {what}{then}")

    def late(self) -> SequenceLateError:
        """Return the error of a sequence that is dropped because it is late."""
        late_ms = self.board._late_ns // 1_000_000
        return SequenceLateError(
            f"this computer was too slow: sequences were over {late_ms} ms late and were skipped, "
            "and intensity restarts at zero"
        )

    # -- what a driver reports, from any thread ------------------------------

    def started(self, proved: ProvedSequence, time_ns: int, board_us: int) -> None:
        """Report when a sequence began on a device that acknowledges them, by `now_ns` and by the
        device's own clock, µs."""
        starts = self.board._starts
        starts[proved.number] = SequenceStart(proved.number, time_ns, board_us)
        self.board.acknowledged += 1
        if len(starts) > _MOST_STARTS:
            del starts[next(iter(starts))]

    def delivered(self, proved: ProvedSequence, scans: int, most: int | None = None) -> None:
        """Report that so many more passes of a sequence were made, or at least that and at most
        ``most``, where the host times them."""
        board = self.board
        with board._news:
            again = proved.number == board._counted
            board._counted = proved.number
            board._statistics.add(proved.sequence, scans, again, most)
            board.acknowledged += not again

    def measured(
        self, sequence: ScanSequence, volts: NDArray[np.float32], lifted: bool | None = None
    ) -> None:
        """Report the voltage that each slot of a delivered sequence needed, (S,) V, and whether
        that is the voltage where nothing touches the electrodes; None if it does not tell."""
        self.board._volts.append((sequence, volts))
        if lifted is not None:
            self.board.lifted = lifted

    def fault(self, reason: str) -> BoardFaultError:
        """Put the board at zero for good, record its fault, and return the error to raise."""
        return self.board._latch(reason)

    # -- for the board -----------------------------------------------------

    def _bar(self) -> None:
        """Refuse all current from now on, and wait for the end of the write under way."""
        self._stopped.set()
        if self._lock.acquire(timeout=WRITE_S):
            self._lock.release()

    def _put_at_zero(self) -> None:
        self._zeroing.append(threading.get_ident())
        try:
            self.board.driver.zero()
        finally:
            self._zeroing.remove(threading.get_ident())
