"""The line to an eTactileKit: commands, dialogues, recovery from lost bytes, and its watchdog.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of each electrode's last slot
    F5      reply: chips        F4      reply: N, the only echo

So speaks the firmware of commit 71adee2 and later. Older ones know no F4, have one height for all
(FB), and FE N×u8 says which electrodes have it: they are put at zero and refused.

A byte lost inside FE would leave the board waiting, and the next byte sent would
complete a pattern shifted by eight bits: up to 41 mA. So every change is guarded:
all pulses are stopped before it (by a mode without any, or a height of zero), a query
follows it, and pulses come back only when that has been answered. A lost byte swallows the
query: no answer, no pulses, and the driver resets the board's parser. Numbers avoid bytes
that look like commands, and where one byte of a word may be lost, zeros that follow make it
smaller, never larger. Not guarded: a *doubled* byte (USB and TCP make none).
"""

import contextlib
import socket
import subprocess
import sys
import threading
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
import serial
from numpy.typing import NDArray
from serial.urlhandler import protocol_socket

from smarttouch.base.errors import BoardError, OtherDeviceError, SilentBoardError
from smarttouch.base.posix import HAS_POSIX, prioritized
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards import kits
from smarttouch.boards.kits import watchdog
from smarttouch.boards.line import Line
from smarttouch.stimulation.safety_gate import ProvedSequence

FIRST_COMMAND = 0xF4
VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0  # load fitted in parallel with the skin; it takes V / 66 kΩ of the current
COMPLIANCE_V = 300.0  # limit of its switches (HV513), the largest voltage of a reading
ZEROS = bytes(2 * 255 + 4)  # padding longer than the rest of any command
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
END = bytes(3)  # end of any command that has lost a byte
AT_REST = (
    b"\xfc\0" + END, NO_SENSE, b"\xfb\0\0" + END, b"\xfa\x01\0" + END,
    b"\xf7\0" + END, b"\xf6\x0a\0" + END,
)  # fmt: skip
"""Puts every published firmware at zero: no electrodes, no sense pulses, no height (or mode 0), the
shortest pulses, ten scans a second. No other known board takes a byte of it for a query or a
pattern."""


QUIET = b"\xfb\x02\xfb\x02"  # stops all pulses from the next scan on
LOAD = b"\xfb\x02\xfe"  # before a pattern, which is loaded while nothing flows
GO = b"\xfb\0"  # starts its pulses from the next scan on


def zero_anywhere(outputs: int) -> bytes:
    """Return the bytes that put a board at zero in any state of its parser: no sense pulses, no
    pulses at all, and a pattern of zeros.

    Zeros first: they complete any half command as a smaller one, with no pulses meanwhile, and a
    lost byte costs a spare one, never the next command.
    """
    return bytes(2 * outputs + 4) + NO_SENSE + b"\xfb\x02\x02\x02\xfe" + bytes(2 * outputs)


@dataclass(frozen=True)
class Span:
    """Earliest and latest possible time of an event, ns."""

    early: int
    late: int


Readings = NDArray[np.uint16]

ECHO_S = 0.1
CHIPS_S = 0.5  # longest time to an answer
MORE_S = 0.03  # wait for more than the answer: USB chips keep bytes for 16 ms
FORGETS_S = 2.15  # silence after which a partial command is dropped
MOST_LOSSES = 4  # lost commands in a row after which the firmware cannot be driven safely
LOOKS = 5  # answers in a row without an echo after which the firmware has none


class ETactileKitLine:
    """Dialogues with an eTactileKit.

    The board repeats its last pattern without a host: a watchdog is armed before anything that can
    become a current. ``lock`` is held for a dialogue, so that zero does not come between a command
    and its answer.
    """

    def __init__(self, line: Line, outputs: int) -> None:
        self.line: Line = line
        self.outputs: int = outputs
        self.zero: bytes = zero_anywhere(outputs)
        self.lock: AbstractContextManager[bool] = threading.RLock()
        self._echo = bytes([outputs])
        self._losses = self._chips = 0
        self._watched: WatchedPort | None = None

    def connect(self, name: str) -> int:
        """Open the port, put any firmware at zero, and return its number of outputs. Another device
        than before gets nothing but a question."""
        line, is_known = self.line, self._is_known
        require_watchdog()
        line.connect(name, self._watch)
        if line.reopened and not is_known:
            self._recognize()
            self._arm()
            line.write(self.zero)
        else:
            # Only a reset takes the time to boot.
            line.pause(kits.BOOT_S)
        capacity = self._identify()
        self._arm()
        return capacity

    @property
    def is_at_zero(self) -> bool:
        """Whether the watchdog has put the board at zero."""
        return self._watched is not None and self._watched.at_zero

    @property
    def _is_known(self) -> bool:
        """Whether it is the same board as before, by its USB numbers."""
        return self.line.reopened and self.line.identity is not None

    def _watch(self, port: Port) -> Port:
        """Return the port, shared with a watchdog; the same board, which is back, gets zero."""
        if self._is_known:
            with contextlib.suppress(*LINE_ERRORS):
                port.write(self.zero)
        self._watched = WatchedPort(port, self.zero)
        if self._is_known:
            self._arm()
        return self._watched

    def _arm(self) -> None:
        assert self._watched is not None
        try:
            self._watched.arm()
        except LINE_ERRORS as error:
            raise self.line.lost(f"has vanished ({reason(error)})") from None

    # -- detection -----------------------------------------------------------

    def _identify(self) -> int:
        chips = self._chips = self._wake()
        capacity = 8 * chips
        if self.outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {self.line.name} has {capacity} outputs, the profile needs "
                f"{self.outputs}: use the profile of this board"
            )
        self._require_echo(chips)
        # No sense pulses: the guard of every change relies on that.
        settings = QUIET + NO_SENSE + bytes([0xFC, self.outputs])
        if self.line.ask(settings + PING, 1, ECHO_S) != self._echo:
            raise self.line.lost("does not echo its number of electrodes")
        return capacity

    def _wake(self) -> int:
        """Put the board at zero and its parser at the start of a command; return its number of
        chips."""
        for pause_s in (0.01, FORGETS_S):
            # An earlier host may have left half a pattern, which any byte but zero would complete
            # as a current. What zeros do not end, a silence does.
            self.line.write(ZEROS)
            self.line.pause(pause_s)
            for command in AT_REST:
                self.line.write(command)
            if answer := self.line.ask(CHIPS, 1, CHIPS_S):
                return answer[0]
        raise SilentBoardError(
            f"the board at {self.line.name} does not answer as an eTactileKit does: check that "
            "it is on, and switch it off and on"
        )

    def _require_echo(self, chips: int) -> None:
        """Raise unless the firmware echoes; its number of electrodes is zero meanwhile."""
        for _ in range(LOOKS):
            # The answer to the second byte shows whether the first was a query.
            if self.line.ask(PING + CHIPS, 2, CHIPS_S + ECHO_S) == bytes([0, chips]):
                return
        for command in AT_REST:
            self.line.write(command)
        raise BoardError(
            f"the eTactileKit at {self.line.name} does not echo: its firmware is older than commit "
            "71adee2, or damaged: flash the newest one of the kit's repository, "
            "aid-lab-org/eTactileKit"
        )

    def _recognize(self) -> None:
        """Ask a device that has come back whether it is the same board, where USB does not tell."""
        # No zeros before the query: another device might act on them.
        for pause_s in (0.0, FORGETS_S):
            self.line.pause(pause_s)
            if received := self.line.ask(CHIPS, 1, CHIPS_S):
                # A longer answer is another device's; zero waits only briefly for that.
                received += self.line.read(1, MORE_S)
                break
        if received != bytes([self._chips]):
            raise OtherDeviceError(
                f"what is at {self.line.name} now does not answer as that board did: nothing but "
                "this question was sent"
            )

    # -- queries -------------------------------------------------------------

    def exchange(
        self, body: bytes, *, ask: bool = False, drives: ProvedSequence | None = None
    ) -> tuple[Span, Readings] | None:
        """Send commands and wait until they are executed; return the span in which that was and the
        readings (N,) before them in the board's order, all zero if not asked for. If the answer is
        wrong, lead the parser to the start of a command, with no pulses, and return None. Commands
        that start the pulses of a sequence come with it, in ``drives``."""
        expected = 2 * self.outputs * ask + 1
        begun_ns = self.line.now_ns()
        answer = self.line.ask(READINGS * ask + body + PING, expected, ECHO_S, drives)
        span = Span(begun_ns, self.line.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            self._resync()
            return None
        self._losses = 0
        if ask:
            return span, np.frombuffer(answer[:-1], "<u2")
        return span, np.zeros(self.outputs, np.uint16)

    def _resync(self) -> None:
        """Resynchronize the board's parser to the start of a command; nothing flows meanwhile."""
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise BoardError(
                f"{self._losses} commands in a row were lost on the way to the eTactileKit at "
                f"{self.line.name}, so it cannot be driven safely: use another cable and port, or "
                "flash the newest firmware of the kit's repository, aid-lab-org/eTactileKit"
            )
        # Zeros complete any half pattern, and are no commands; if not, silence does.
        for zeros, pause_s in ((ZEROS, 0.01), (b"", FORGETS_S)):
            self.line.write(zeros)
            self.line.pause(pause_s)
            # The answer may only be late, and a silence would cost far more.
            if self.line.ask(QUIET + bytes(4) + PING, 1, CHIPS_S) == self._echo:
                return
        raise self.line.lost("does not answer any more")


BEAT_S = 0.02
ENDS_WITHIN_S = 1.5  # of the watchdog; zero for 253 outputs takes .4 s in small pieces
KEPT_MS = 100.0  # longest time from the end or hang of this program to the first byte of zero
STALE = 0.8
"""Part of the watchdog's patience after which this program writes nothing more: no byte of it
follows the zero of its watchdog."""
COMMAND = [sys.executable, "-I", "-S", watchdog.__file__]
"""Of the watchdog; isolated: no user setting or package can keep it from starting."""
_AT_ZERO = (watchdog.GONE, watchdog.SILENT)


def require_watchdog() -> None:
    """Raise where no watchdog can run."""
    if not HAS_POSIX:
        raise BoardError(
            "this board goes on with its last pattern if its program hangs, and the watchdog that "
            "would put it at zero needs Linux or macOS: use simulated: here"
        )


class WatchedPort:
    """Serial port or TCP connection that a `watchdog` puts at zero when this program is gone.

    It writes nothing once the watchdog has ended or may have run out of patience. POSIX only (tried
    on Linux).
    """

    def __init__(self, port: Port, zero: bytes) -> None:
        self.timeout: float | None = port.timeout
        self._port, self._zero = port, zero
        self._closing = threading.Event()
        self._beaten_s: float | None = None  # time of the last heartbeat
        self._beating = threading.Thread(target=self._beat, name="watchdog heartbeat", daemon=True)
        self._control, control = socket.socketpair()
        try:
            with control:
                ends = (_descriptor(port), control.fileno())
                self._process = subprocess.Popen(
                    [*COMMAND, *map(str, ends), zero.hex()], stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd="/", pass_fds=ends,
                    start_new_session=True,
                )  # fmt: skip
        except (OSError, ValueError) as error:
            self._control.close()
            port.close()
            raise BoardError(
                f"the watchdog of the board cannot be started ({reason(error)}), and without it "
                "the board would go on when this program ends"
            ) from None

    @property
    def process_id(self) -> int:
        """Process id of the watchdog."""
        return self._process.pid

    @property
    def at_zero(self) -> bool:
        """Whether the watchdog has ended and put the board at zero."""
        return self._process.poll() in _AT_ZERO

    def arm(self) -> None:
        """Let the watchdog put the board at zero from now on."""
        if self._beaten_s is None:
            self._send_beat()
            self._beating.start()

    def write(self, data: bytes) -> int:
        """Write bytes; raise SerialException if the watchdog has ended or may write zero now.

        Where this program stood still just before the bytes went out, they may have followed the
        zero of the watchdog: then zero follows them at once.
        """
        self._require_beat()
        self._port.write(data)
        try:
            self._require_beat()
        except serial.SerialException:
            # Twice, as the first may end a command that was cut.
            self._port.write(2 * self._zero)
            raise
        return len(data)

    def _require_beat(self) -> None:
        if self._beaten_s is None:
            return
        silence_s = _now_s() - self._beaten_s
        if silence_s > STALE * watchdog.SILENCE_S or self._process.poll() is not None:
            self._end()
            raise serial.SerialException(
                "this program stood still, so its watchdog put the board at zero"
                if self.at_zero
                else "its watchdog has ended"
            )

    def read(self, count: int = 1) -> bytes:
        """Return as many bytes as come within ``timeout``, at most ``count``."""
        self._port.timeout = self.timeout
        return bytes(self._port.read(count))

    def reset_input_buffer(self) -> None:
        """Drop all input from the board."""
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Put the board at zero by the watchdog, end it, and close the port."""
        if self._closing.is_set():
            return
        self._closing.set()
        if self._beating.ident:
            self._beating.join()
        self._end()
        with contextlib.suppress(*LINE_ERRORS):
            self._port.close()

    def _end(self) -> None:
        """Let the watchdog put the board at zero and end; put it at zero here if it could not."""
        self._control.close()
        try:
            self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._beaten_s is not None and not self.at_zero:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.write(self._zero)

    @prioritized()
    def _beat(self) -> None:
        while not self._closing.wait(BEAT_S):
            before_s = self._beaten_s or 0.0
            if _now_s() - before_s > STALE * watchdog.SILENCE_S:
                # The watchdog may be writing zero already.
                return
            try:
                self._send_beat()
            except OSError:
                # It is gone; if it was killed, the board is not at zero yet.
                self._end()
                return

    def _send_beat(self) -> None:
        now_s = _now_s()
        self._control.sendall(b".")
        self._beaten_s = now_s


def _now_s() -> float:
    """Return a time that also counts while the computer is suspended, where the system has one."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return time.monotonic() if clock is None else time.clock_gettime(clock)


def _descriptor(port: Port) -> int:
    if not isinstance(port, (serial.Serial, protocol_socket.Serial)):
        raise ValueError("it needs a serial device or tcp://HOST:PORT")
    return int(port.fileno())
