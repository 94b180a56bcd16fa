"""Line to a device: the only way by which a driver reaches it, which a stop closes."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

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
from smarttouch.boards.reports import SequenceStart
from smarttouch.stimulation.safety_gate import ProvedSequence
from smarttouch.stimulation.scan_sequence import ScanSequence

if TYPE_CHECKING:
    from smarttouch.boards.board import Board

__all__ = ["Line"]

PIECE = 4096  # bytes written at once: a stop waits for one piece, not for a whole packet
WRITE_S = 0.6  # longest time that a stop waits for one write: ports give up after .5 s
BLOCKED_S = 1.0  # longest time that zero waits for a write that does not end
RECOVER_S = 3.0  # time to wait for a lost port
_MOST_STARTS = 256


class _Zeroing(threading.local):
    """Number of blocks of this thread that write zero."""

    depth = 0


class Line:
    """Line of one board to its device; only `Board` makes one.

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
    identity : UsbIdentity or None
        USB identity of the device; None if it has none.
    """

    def __init__(self, board: "Board") -> None:
        self.name: str = ""
        self.reopened = False
        self.identity: UsbIdentity | None = None
        self.board: Board = board
        self._gate = board._gate
        self._port: Port | None = None
        self._stopped = threading.Event()
        # Reentrant: a program's own signal handler may stop while its thread is writing.
        self._lock = threading.RLock()
        self._dialogue = threading.RLock()
        self._zeroing = _Zeroing()

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
        self.name = name
        self._port = wrap(port)

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
        errors as of `write`."""
        begun = False
        with uninterrupted():
            if not self._lock.acquire(timeout=BLOCKED_S if self._zeroing.depth else -1):
                raise self.lost("is blocked: check the cable")
            try:
                if self._stopped.is_set():
                    self.require_running()
                if proved is not None:
                    if type(proved) is not ProvedSequence:
                        kind = type(self.board.driver).__name__
                        raise BoardError(f"{kind} sends what the gate has not proved")
                    if proved.session != self._gate.session:
                        raise BoardStoppedError("the board was closed before this: begin at zero")
                    permits = self._gate.ramp.permits
                    if self.board.clock.now_ns() > proved.write_before_ns or not permits(
                        proved.strength_ppb, proved.sequence.time_ns
                    ):
                        raise self.late()
                begun = True
                yield
                if proved is not None:
                    self.board._note_written(proved)
            finally:
                self._lock.release()
                if begun and self._stopped.is_set() and not self._zeroing.depth:
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
            return self._gate.repeated(proved, due_ns)
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

    def now_ns(self) -> int:
        """Return the time by the board's clock."""
        return self.board.clock.now_ns()

    def wait_until(self, time_ns: int) -> None:
        """Wait until a time of the board's clock; raise if the board is stopped meanwhile."""
        self.board.clock.wait_until(time_ns, self._stopped)
        self.require_running()

    def pause(self, seconds: float) -> None:
        """Wait; raise if the board is stopped meanwhile."""
        if self._zeroing.depth:
            time.sleep(seconds)
        else:
            self._stopped.wait(seconds)
            self.require_running()

    @property
    def is_stopped(self) -> bool:
        """Whether writes are refused; never within `Driver.zero`."""
        return self._stopped.is_set() and not self._zeroing.depth

    def require_running(self) -> None:
        """Raise BoardStoppedError if the board was stopped, but not within `Driver.zero`."""
        if self._stopped.is_set() and not self._zeroing.depth:
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
        board, starts = self.board, self.board._starts
        with board._news:
            starts[proved.number] = SequenceStart(proved.number, time_ns, board_us)
            if len(starts) > _MOST_STARTS:
                del starts[next(iter(starts))]
            board.acknowledged += 1

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
        board = self.board
        board._volts.append((sequence, volts))
        board.lifted = board.lifted if lifted is None else lifted

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
        self._zeroing.depth += 1
        try:
            self.board.driver.zero()
        finally:
            self._zeroing.depth -= 1
