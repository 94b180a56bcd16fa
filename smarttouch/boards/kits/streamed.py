"""Base class of drivers without acknowledgments: a thread sends the newest sequence."""

import contextlib
import threading
import time
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from smarttouch.base.clock import LATE_NS, prioritized
from smarttouch.base.errors import BoardError, BoardStoppedError, LineLostError
from smarttouch.base.wire.port import (
    LINE_ERRORS,
    Port,
    UsbIdentity,
    device_of,
    identity_of,
    open_port,
    reason,
    reopen_port,
    write_before,
)
from smarttouch.boards.board import Board, BoardReport
from smarttouch.boards.faults import restart_lost_board
from smarttouch.boards.reports import HostStatistics
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import Rise, SafetyLimits
from smarttouch.stimulation.safety_limits import parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence


@dataclass(frozen=True, eq=False)
class Job:
    """Sequence on its way to the board."""

    number: int
    sequence: ScanSequence
    data: bytes
    times: int
    due_ns: int = 0  # planned start, by the board's clock


BOOT_S = 1.0  # boot time of a board that resets when its port is opened
RECOVER_S = 3.0  # time to wait for a lost port


class StreamedBoard(Board):
    """Board on a line without acknowledgments.

    The caller's thread proves and encodes; a thread of the driver sends. There
    is one place between them: a newer sequence replaces one that still waits,
    so that there never is a backlog. The port is a device, or any URL that pyserial knows; limits
    and output are of the finger's profile.
    """

    kind: str  # name of the driver, for messages
    drives_in_send = False
    _zero_anywhere: bytes = b""
    """Puts a board that goes on by itself at zero, at any point of its byte stream."""
    can_be_asked: ClassVar[bool] = False  # whether a harmless query identifies such a board
    room_s: ClassVar[float] = 0.0
    """Time that a sequence waits for the one before it to be taken, beside a few of its periods,
    rather than replace it; 0 if it does not."""

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        super().__init__(limits, output)
        if not port:
            raise BoardError(f"{self.kind}: needs a port, for example {self.kind}:/dev/ttyUSB0")
        if output is not None and output.kind != "one-against-all":
            raise BoardError(
                f"a {self.kind} board is one-against-all, the profile needs {output.kind}: use "
                f"the profile {self.default_profile}"
            )
        self._port_name = port
        self._number = 0
        self._waiting: Job | None = None
        self._busy = False
        self._late_unreported = False
        self._opening = False
        self._over_s = 0.0
        self._last_begun = 0
        self._fault: BoardError | None = None
        self._away: LineLostError | None = None
        """How a board was lost that is not back, and goes on by itself."""
        self._closing = threading.Event()
        self._news = threading.Condition()
        self._line = threading.RLock()
        # What the gate proved at once may wait here: the rise that the skin gets is of the line.
        self._rise = Rise(limits.ramp_ns)
        self._serial: Port | None = None
        self._identity: UsbIdentity | None = None
        self._thread: threading.Thread | None = None

    # -- the contract ------------------------------------------------------

    @property
    def device(self) -> str | None:
        return device_of(self._port_name)

    def _open(self) -> None:
        self._books, self._away = HostStatistics(self._gate.limits.electrodes), None
        port = open_port(self._port_name)
        self._identity = identity_of(port)
        self._start(port)

    def _start(self, port: Port, *, again: bool = False) -> None:
        self._serial = self._wrap(port)
        self._fault, self._waiting, self._busy = None, None, False
        self._late_unreported = False
        self._rise.restart()
        self._closing.clear()
        # From here to the end of the greeting nothing flows, and the line is this thread's.
        self._opening = True
        try:
            if again:
                # It may go on with its last pattern: only a reset takes the time to boot.
                if self._identity is None:
                    self._recognize()
                self._zero_first()
            if not again or self._identity is not None:
                self._pause(BOOT_S)
            self._greet()
            with self._news:
                self._opening, self._away = False, None
                self._go_on_unless_stopped()
        except BaseException:
            self._opening = False
            self._close()
            raise
        self._thread = threading.Thread(target=self._run, name="board sender", daemon=True)
        self._thread.start()

    def _recover(self, lost: LineLostError) -> None:
        if self.capabilities.time_to_zero_ms is None and not self._at_zero():
            self._away = lost
        self._close()
        if self._identity is None and not self.can_be_asked:
            raise BoardError(
                f"{lost}; it has no USB serial number and cannot be identified, so "
                "nothing is sent to what comes back: check the cable, then start again"
            )
        try:
            restart_lost_board(self._start_again, lost)
        except BoardStoppedError:
            # Not at zero, whatever has stopped it.
            if self._away is not None:
                raise self._away from None
            raise

    def _start_again(self) -> None:
        port = reopen_port(self._port_name, RECOVER_S, self._identity, self._pause)
        if self._identity is not None:
            # It is the same board, and may go on with its last pattern while all else starts.
            with contextlib.suppress(*LINE_ERRORS):
                port.write(self._zero_anywhere)
        self._start(port, again=True)

    def _send(self, sequence: ScanSequence, times: int) -> int:
        data = self._encode(sequence)
        patience_s = self.room_s and self.room_s + 4e-6 * sequence.period_us
        with self._news:
            self._news.wait_for(
                lambda: self._waiting is None or self._fault is not None or self._closing.is_set(),
                patience_s,
            )
            if self._fault is not None:
                raise self._fault
            if self._late_unreported:
                self._late_unreported = False
                self.dropped_late += 1
                raise self._late()
            self._number += 1
            self.replaced += self._waiting is not None
            self._waiting = Job(self._number, sequence, data, times, self._due_ns)
            self._news.notify_all()
        return self._number

    def _stop(self) -> None:
        self._closing.set()
        with self._news:
            self._waiting = None
            self._news.notify_all()
            opening = self._opening
        if self._away is not None:
            raise self._away
        if opening or self._serial is None or not self._serial.is_open:
            return
        with self._line:
            try:
                self._zero()
            except LineLostError:
                if self._at_zero():
                    return
                # Where silence is zero, only the earlier fault needs a report.
                if self._fault is None or self.capabilities.time_to_zero_ms is None:
                    raise

    def _close(self) -> None:
        self._closing.set()
        with self._news:
            self._news.notify_all()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(RECOVER_S)
        if self._serial is not None:
            with contextlib.suppress(*LINE_ERRORS):
                self._serial.close()

    def drain(self, timeout_s: float = 1.0) -> None:
        deadline = time.monotonic() + timeout_s
        with self._news:
            self._news.wait_for(
                lambda: (
                    self._fault is not None
                    or self._closing.is_set()
                    or (self._waiting is None and not self._busy)
                ),
                timeout_s,
            )
            over = min(deadline, self._over_s)
        self._closing.wait(max(0.0, over - time.monotonic()))

    def report(self) -> BoardReport:
        return self._books.report()

    # -- what a driver adds ------------------------------------------------

    def _wrap(self, port: Port) -> Port:
        """Return the line used in place of an open port."""
        return port

    def _at_zero(self) -> bool:
        """Whether another process has put the board at zero."""
        return False

    def _recognize(self) -> None:
        """Query a restored line whether it is the same board, where USB gives no identity; raises
        OtherDeviceError if it is not."""

    def _zero_first(self) -> None:
        """Write zero to a restored line of the same board, at any point of its byte stream."""

    @abstractmethod
    def _greet(self) -> None:
        """Detect the board, and put it at zero."""

    @abstractmethod
    def _encode(self, sequence: ScanSequence) -> bytes:
        """Return the bytes of a sequence; raise BoardError if the board cannot make it."""

    @abstractmethod
    def _zero(self) -> None:
        """Put all electrodes at zero; raise LineLostError if that is not certain."""

    @abstractmethod
    def _serve(self) -> None:
        """Send waiting sequences until closing."""

    # -- the line ----------------------------------------------------------

    @prioritized()
    def _run(self) -> None:
        try:
            self._serve()
        except BoardStoppedError:
            self._rest()
        except BoardError as error:
            self._fail(error)
        except LINE_ERRORS as error:
            self._fail(self._lost(f"has vanished ({reason(error)})"))
        except Exception as error:
            # Its pattern would be shown on, and heartbeats sent, with nobody to end it.
            fault = BoardError(f"the driver {self.kind} has failed ({error!r})")
            fault.__cause__ = error
            self._fail(fault)
            with contextlib.suppress(BoardError), self._line:
                self._zero()

    def _take(self, until_s: float | None = None) -> Job | None:
        """Return the newest sequence, or None at a time or when closing."""
        with self._news:
            timeout = None if until_s is None else max(0.0, until_s - time.monotonic())
            self._news.wait_for(
                lambda: self._waiting is not None or self._closing.is_set(), timeout
            )
            job, self._waiting = self._waiting, None
            self._busy = job is not None and not self._closing.is_set()
            self._news.notify_all()
            return job if self._busy else None

    def _is_in_time(self, job: Job, due_ns: int) -> bool:
        """Whether a sequence may begin now: it is not late, and does not rise too fast for it."""
        strength_ppb = self._gate.limits.strength_of(job.sequence)
        return not self._is_late(due_ns) and (
            not job.sequence.drives or self._rise.permits(strength_ppb, self._clock.now_ns())
        )

    def _note_rise(self, job: Job) -> None:
        """Enter the intensity of a sequence whose bytes have just been written."""
        sequence = job.sequence
        lasting_ns = 1000 * sequence.period_us * job.times * sequence.drives
        ppb = parts_per_billion(sequence.intensity)
        strength_ppb = self._gate.limits.strength_of(sequence)
        self._rise.note(ppb, strength_ppb, self._clock.now_ns(), lasting_ns)

    def _drop_late(self, job: Job) -> None:
        """Count a sequence that is not sent; the next one must begin at zero."""
        self._rise.restart()
        with self._news:
            self.dropped_late += 1 + (self._waiting is not None)
            self._waiting = None
            self._late_unreported = True
            self._busy = False
            self._news.notify_all()

    def _delivered(self, job: Job, scans: int = 1) -> None:
        with self._news:
            self._over_s = time.monotonic() + scans * job.sequence.period_us / 1e6
            again = job.number == self._last_begun
            self._books.add(job.sequence, scans, again)
            self.acknowledged += not again
            self._last_begun = job.number

    def _rest(self) -> None:
        """Wake threads that drain, as nothing is left to do."""
        with self._news:
            self._busy = False
            self._news.notify_all()

    def _write(self, data: bytes) -> None:
        with self._open_port("cannot be written to") as port:
            port.write(data)

    def _write_in_time(self, data: bytes, due_ns: int) -> bool:
        """Write data that is due at a time, or nothing if that is too long ago."""
        with self._open_port("cannot be written to") as port:
            return write_before(port, data, due_ns + LATE_NS, self._clock.now_ns)

    def _read(self, count: int, within_s: float) -> bytes:
        """Return as many bytes as come in time, at most ``count``."""
        with self._open_port("has vanished") as port:
            port.timeout = within_s
            return bytes(port.read(count))

    def _flush(self) -> None:
        with self._open_port("has vanished") as port:
            port.reset_input_buffer()

    @contextlib.contextmanager
    def _open_port(self, what: str) -> Iterator[Port]:
        """Lend the line; raise LineLostError if it fails."""
        assert self._serial is not None
        try:
            yield self._serial
        except LINE_ERRORS as error:
            raise self._lost(f"{what} ({reason(error)})") from None

    def _fail(self, fault: BoardError) -> None:
        with self._news:
            self._fault = self._fault or fault
            self._busy = False
            self._news.notify_all()

    def _lost(self, what: str) -> LineLostError:
        after = self._aftermath()
        return LineLostError(f"the board at {self._port_name} {what}{after}")

    def _aftermath(self) -> str:
        return ""
