"""Base class of drivers, and the line to a device."""

import contextlib
import json
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardFaultError,
    BoardStoppedError,
    LineLostError,
    SafetyError,
    SequenceLateError,
)
from smarttouch.base.files import owner_only
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
from smarttouch.boards.reports import BoardReport, Capabilities, latch
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence, ScanTiming

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

__all__ = ["Driver", "Line"]

PIECE = 4096  # bytes written at once: a stop waits for one piece, not for a complete packet
WRITE_S = 0.6  # a stop waits at most this time for a running write; a port gives up after 0.5 s
BLOCKED_S = 1.0  # `Driver.zero` waits at most this time for a write that blocks
RECOVER_S = 3.0  # longest wait for a lost port to come back
_MOST_STARTS = 256


class Driver(ABC):
    """Base class of drivers. A driver knows the wire format of one kind of device.

    `Board` has the safety gate, ramp, clock, stop, sender thread and recovery. It calls the methods
    below. A driver sends everything through the `Line` that `open` receives, and reports deliveries
    to this line. A driver needs no lock, thread or clock.

    To open a URL, a driver is called with the text after the colon, a copy of the limits, the
    profile's table ``output`` or None, and the options of the URL by keyword.
    """

    default_profile: ClassVar[str] = DEFAULT_PROFILE
    """Name of the default profile."""
    takes_wiring: ClassVar[bool] = False
    """Whether users wire the outputs, so that profiles may contain ``output.wiring``."""
    keeps_kernels: ClassVar[bool] = False
    """Whether the device can store kernels; slots are then planned as sums of kernels."""
    timing: ScanTiming = ScanTiming()
    """Timing constraints of the device, known before it is opened."""
    port: str | None = None
    """Name of the device's port, or None. Faults of a device without a port are not recorded."""

    @abstractmethod
    def open(self, line: "Line", limits: SafetyLimits) -> Capabilities:
        """Connect, identify the device, and set all electrodes to zero.

        After a lost connection the board calls this again, with ``line.reopened`` set.

        Parameters
        ----------
        line : Line
            Line to the device; store it.
        limits : SafetyLimits
            Copy of the limits, for the firmware and for checks of reports.

        Raises
        ------
        BoardError
            If the wrong device answers, or no device.
        """

    @abstractmethod
    def write(self, proved: ProvedSequence) -> None:
        """Send a sequence to the device, by `Line.write` or within `Line.current`.

        If the host starts each pass (`Capabilities.host_timed`), return after the last pass, or
        earlier if `Line.has_newer` is true. Errors are then raised by the next `Board.send`.
        """

    @abstractmethod
    def zero(self) -> None:
        """Set all electrodes to zero, from any thread and at any time, also during `write`.

        Raises
        ------
        BoardError
            If any electrode might not be at zero.
        """

    def close(self) -> None:  # noqa: B027, optional for drivers
        """Release what `open` acquired, even if `open` failed. `Board` itself closes the line."""

    def idle(self) -> float | None:
        """Send heartbeats and read answers between writes, in the board's sender thread.

        The thread calls this after opening and after each `write`.

        Returns
        -------
        float or None
            Seconds until the next call; None means after the next write.
        """
        return None

    def store_kernels(self, table: KernelTable) -> None:  # noqa: B027, optional for drivers
        """Store the kernels of the next sequences on the device."""

    def status(self) -> BoardReport | None:
        """Return the device's report of what it delivered. If None, the host's report is used."""
        return None


class Line:
    """Connection of a board to its device; drivers must send and receive only through it.

    It holds the lock of `Board.stop` during writes. It rejects sequences that are late or raise the
    intensity too fast. After a stop it rejects everything except writes of `Driver.zero`.

    Attributes
    ----------
    board : Board
        The board. Drivers update its ``refused``, ``replaced``, ``force_n`` and ``notes``.
    name : str
        Name of the connected port.
    reopened : bool
        Whether the connection was lost. If so, `connect` waits for the device for `RECOVER_S`.
    now_ns : callable
        Returns the time by the board's clock.
    identity : UsbIdentity or None
        USB identity of the device, or None.
    recording : Path or None
        File that records the bytes of the line, as ``{"time_ns": …, "event": "sent", "hex":
        "ff00"}``; events are ``opened`` (with the port's name), ``sent`` and ``received``.
    """

    def __init__(self, board: "Board") -> None:
        self.board: Board = board
        self.name: str = ""
        self.reopened: bool = False
        self.now_ns: Callable[[], int] = board.clock.now_ns
        self.identity: UsbIdentity | None = None
        self.recording: Path | None = None
        self._entries: SimpleQueue[str] = SimpleQueue()  # lines of the recording; "" ends it
        self._port: Port | None = None
        self._stopped = threading.Event()
        # Reentrant: a signal handler may interrupt a write and stop the board in the same thread.
        self._lock, self._dialogue = threading.RLock(), threading.RLock()
        self._zeroing: list[int] = []  # ids of threads in `Driver.zero`, one for each nested call

    # -- the connection ----------------------------------------------------

    def connect(
        self, name: str, wrap: Callable[[Port], Port] = lambda port: port, baudrate: int = 921600
    ) -> None:
        """Open a port; after a lost connection, wait until the port is back.

        Parameters
        ----------
        name : str
            A device, ``tcp://HOST:PORT``, or any URL that pyserial knows.
        wrap : callable
            Returns a replacement for the open port, such as a `WatchedPort`.
        baudrate : int

        Raises
        ------
        BoardError
            If the port cannot be opened.
        OtherDeviceError
            If another device is at the port.
        """
        if self.reopened:
            port = reopen_port(name, RECOVER_S, self.identity, self.pause, baudrate)
        else:
            port = open_port(name, baudrate)
            self.identity = identity_of(port)
        self.name, self._port = name, wrap(port)
        if self.recording is not None:
            self._writer = threading.Thread(target=self._keep, args=(self.recording,), daemon=True)
            self._writer.start()
            self._note("opened", name.encode())

    def disconnect(self) -> None:
        """Close the port, if one is open."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*LINE_ERRORS):
                port.close()
            if self.recording is not None:
                self._note("sent", getattr(port, "left_to_watchdog", b""))
                self._entries.put("")
                self._writer.join(WRITE_S)

    # -- writing -----------------------------------------------------------

    def write(self, data: bytes, proved: ProvedSequence | None = None) -> None:
        """Write bytes to the port.

        Parameters
        ----------
        data : bytes
        proved : ProvedSequence, optional
            Sequence that the device delivers from these bytes; None if they cause no current.

        Raises
        ------
        SequenceLateError
            If the sequence is late, or would raise the intensity too fast.
        BoardStoppedError
            If the board was stopped, unless `Driver.zero` calls this.
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
        if self.recording is not None:
            self._note("sent", data)

    @contextlib.contextmanager
    def current(self, proved: ProvedSequence | None = None) -> Iterator[None]:
        """Hold the lock of `Board.stop` during a ``with`` block that writes to the device. At the
        end of the block the sequence counts as written. Arguments and errors as for `write`."""
        board, begun, zeroing = self.board, False, threading.get_ident() in self._zeroing
        # If a finger may be on the board, delay exceptions of signal handlers until the write ends.
        with uninterrupted() if board.announced else contextlib.nullcontext():
            if not self._lock.acquire(timeout=BLOCKED_S if zeroing else -1):
                raise self.lost("is blocked: check the cable")
            try:
                if self._stopped.is_set():
                    self.require_running()
                if proved is not None:
                    if type(proved) is not ProvedSequence:
                        kind = type(board.driver).__name__
                        raise BoardError(f"{kind} sent an unproved sequence: send a ProvedSequence")
                    if proved.session != board._gate.session:
                        raise BoardStoppedError("the board was opened again: start at intensity 0")
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
                    # All parts of a sequence have the same number: count only the first part.
                    if not (can.acknowledges or can.host_timed or proved.number == board._counted):
                        self.delivered(proved, proved.times)
            finally:
                self._lock.release()
                if begun and self._stopped.is_set() and not zeroing:
                    # A stop may have come before this write ended: set the board to zero again.
                    self._put_at_zero()

    def later(self, proved: ProvedSequence, due_ns: int) -> ProvedSequence:
        """Return a copy of a proved sequence, with the later start ``due_ns``. Drivers need a copy
        for each repetition that the host starts, and after a wait for an earlier sequence.

        Raises
        ------
        SequenceLateError
            If ``due_ns`` is after the latest possible start of the last repetition.
        """
        try:
            return self.board._gate.repeated(proved, due_ns)
        except SafetyError:
            raise self.late() from None

    # -- reading -----------------------------------------------------------

    def read(self, count: int, within_s: float) -> bytes:
        """Return the bytes received within ``within_s``, at most ``count``."""
        with self._open_port("has vanished") as port:
            port.timeout = within_s
            data = bytes(port.read(count))
        if self.recording is not None:
            self._note("received", data)
        return data

    def ask(
        self, data: bytes, count: int, within_s: float, proved: ProvedSequence | None = None
    ) -> bytes:
        """Write a query and return the answer, at most ``count`` bytes. Until the answer arrives,
        queries of other threads wait. For ``proved`` see `write`."""
        with self._dialogue:
            self.discard_input()
            self.write(data, proved)
            return self.read(count, within_s)

    def read_some(self) -> bytes:
        """Return received bytes; wait briefly for the first one."""
        with self._open_port("has vanished") as port:
            if (data := read_some(port)) is None:
                note = f"another program reads from {self.name}: close it (ModemManager or a "
                note += "serial monitor?)"
                self.board.notes += [note] * (note not in self.board.notes)
                # Pause: with real-time priority this loop could block all other threads.
                time.sleep(0.001)
        if self.recording is not None:
            self._note("received", data or b"")
        return data or b""

    def discard_input(self) -> None:
        """Drop unread bytes."""
        with self._open_port("has vanished") as port:
            port.reset_input_buffer()

    def _note(self, event: str, data: bytes) -> None:
        if data:
            entry = {"time_ns": now_ns(), "event": event, "hex": data.hex()}
            self._entries.put(json.dumps(entry))

    def _keep(self, path: Path) -> None:
        """Write the recording in a separate thread: a slow disk must not delay pulses or a stop."""
        try:
            with open(path, "a", opener=owner_only) as file:
                for entry in iter(self._entries.get, ""):
                    print(entry, file=file, flush=True)
        except OSError as failure:
            self.recording = None
            self.board.notes.append(f"the recording {path} is incomplete: {failure}")

    @contextlib.contextmanager
    def _open_port(self, what: str) -> Iterator[Port]:
        """Yield the port. If it fails, raise LineLostError, with ``what`` in the message."""
        if (port := self._port) is None:
            raise BoardClosedError("the board is not connected: open it first")
        try:
            yield port
        except LINE_ERRORS as error:
            raise self.lost(f"{what} ({reason(error)})") from None

    # -- time and stops ----------------------------------------------------

    def wait_until(self, time_ns: int) -> None:
        """Wait until a time of the board's clock. Raises BoardStoppedError if the board is
        stopped."""
        self.board.clock.wait_until(time_ns, self._stopped)
        self.require_running()

    def pause(self, seconds: float) -> None:
        """Wait some seconds. Raises BoardStoppedError if the board is stopped."""
        if threading.get_ident() in self._zeroing:
            time.sleep(seconds)
        else:
            self._stopped.wait(seconds)
            self.require_running()

    @property
    def is_stopped(self) -> bool:
        """Whether writes are rejected; False within `Driver.zero`."""
        return self._stopped.is_set() and threading.get_ident() not in self._zeroing

    def require_running(self) -> None:
        """Raise BoardStoppedError if the board was stopped, except within `Driver.zero`."""
        if self._stopped.is_set() and threading.get_ident() not in self._zeroing:
            if self.board._fault_found is not None:
                raise self.board._fault_found
            again = "open a new display" if self.board._halted else "open it again"
            raise BoardStoppedError(
                f"the board was stopped, all electrodes are at zero: {again} before sending"
            )

    def has_newer(self) -> bool:
        """Return whether a newer sequence is waiting. If so, drivers skip the remaining passes."""
        return self.board._waiting is not None

    def lost(self, what: str) -> LineLostError:
        """Return the error for a lost connection, as in ``lost("does not answer")``."""
        can, then = getattr(self.board, "capabilities", None), ""
        # Say what the board does now, unless its watchdog has set the board to zero.
        if can is not None and not getattr(self._port, "at_zero", False):
            then = "; it repeats its last pattern: lift the finger, then switch the board off"
            if can.time_to_zero_ms is not None:
                then = f"; it goes to zero {can.time_to_zero_ms:g} ms after the host's last byte"
        return LineLostError(f"the board at {self.name} {what}{then}")

    def late(self) -> SequenceLateError:
        """Return the error for a sequence that is dropped because it is late."""
        late_ms = self.board._late_ns // 1_000_000
        return SequenceLateError(
            f"this computer was too slow: sequences more than {late_ms} ms late were skipped, "
            "and intensity restarts at zero"
        )

    # -- reports of a driver, from any thread ----------------------------------

    def started(self, proved: ProvedSequence, time_ns: int, board_us: int) -> None:
        """Report when a sequence started, by `now_ns` and by the board's clock."""
        starts = self.board._starts
        starts[proved.number] = time_ns, board_us
        self.board.acknowledged += 1
        if len(starts) > _MOST_STARTS:
            del starts[next(iter(starts))]

    def delivered(self, proved: ProvedSequence, scans: int, most: int | None = None) -> None:
        """Add ``scans`` passes of a sequence to the host's report. If ``most`` is given, the number
        of passes is uncertain: at least ``scans`` and at most ``most``."""
        board = self.board
        with board._news:
            again = proved.number == board._counted
            board._counted = proved.number
            board._statistics.add(proved.sequence, scans, again, most)
            board.acknowledged += not again

    def measured(
        self, sequence: ScanSequence, volts: NDArray[np.float32], lifted: bool | None = None
    ) -> None:
        """Report the voltage of each slot of a delivered sequence, (S,) V. ``lifted`` is
        whether the voltages show that nothing touches the electrodes; None if unknown."""
        self.board._volts.append((sequence, volts))
        if lifted is not None:
            self.board.lifted = lifted

    def fault(self, reason: str) -> BoardFaultError:
        """Set the board to zero permanently, record its fault, and return the error to raise."""
        board = self.board
        if board._fault_found is None:
            board._fault_found = BoardFaultError(
                f"{reason}: the board is at zero and latched; have the board checked, then "
                "clear the fault with smarttouch devices clear"
            )
            with contextlib.suppress(BoardError):
                board.halt()
            if board.device is not None:
                latch(board.device, reason)
        return board._fault_found

    # -- for the board -----------------------------------------------------

    def _bar(self) -> None:
        """Reject all later writes except those of `Driver.zero`, and wait for a running write."""
        self._stopped.set()
        if self._lock.acquire(timeout=WRITE_S):
            self._lock.release()

    def _put_at_zero(self) -> None:
        self._zeroing.append(threading.get_ident())
        try:
            self.board.driver.zero()
        finally:
            self._zeroing.remove(threading.get_ident())
