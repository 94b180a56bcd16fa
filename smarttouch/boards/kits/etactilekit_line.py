"""The line to an eTactileKit: its watchdog, commands, dialogues and recovery from lost bytes.

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
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
import serial
from numpy.typing import NDArray
from serial.urlhandler import protocol_socket

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import BoardError, OtherDeviceError, SilentBoardError
from smarttouch.base.posix import HAS_POSIX, prioritized
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards import kits
from smarttouch.boards.driver import Line
from smarttouch.boards.kits import watchdog
from smarttouch.stimulation.safety_gate import ProvedSequence

LARGEST = 1000
"""Counts, about 10 mA: nothing above leaves this host, whatever the limits. Its firmware does not
cap 4095 counts, which are 41 mA."""
FIRST_COMMAND = 0xF4
SHORTEST_US = 7  # shortest pulse: switching on and off takes 6.6 µs

Readings = NDArray[np.uint16]


@dataclass(frozen=True)
class Settings:
    """Settings shared by all slots of a scan."""

    width_us: int
    discharge_us: int
    rate_hz: int
    anodic: bool

    @property
    def period_ns(self) -> int:
        """Period of its timer, in whole µs."""
        return 1_000_000 // self.rate_hz * 1000

    def scan_us(self, outputs: int, slot_extra_us: int = 10) -> int:
        return outputs * (self.width_us + self.discharge_us + slot_extra_us)

    def commands(self, between_hz: int) -> bytes:
        """Return the commands of the settings, twice, each followed by zeros: were a word's first
        byte lost, they would make it zero, not a longer pulse. At ``between_hz`` scans of the old
        and of the new pulses fit."""
        once = (
            QUIET + _END + b"\xf9\0" + _END + b"\xf8\0" + _END
            + b"\xf6" + between_hz.to_bytes(2, "little") + _END
            + bytes([0xFD, self.anodic]) + _END
            + b"\xfa" + self.width_us.to_bytes(2, "little") + _END
            + bytes([0xF7, self.discharge_us]) + _END
        )  # fmt: skip
        return once * 2 + (b"\xf6" + self.rate_hz.to_bytes(2, "little") + _END) * 2


ZEROS = bytes(2 * 255 + 4)  # padding longer than the rest of any command
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
_END = bytes(3)  # end of any command that has lost a byte
AT_REST = (
    b"\xfc\0" + _END, NO_SENSE, b"\xfb\0\0" + _END, b"\xfa\x01\0" + _END,
    b"\xf7\0" + _END, b"\xf6\x0a\0" + _END,
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

    watched: "WatchedPort"  # the port, once it is open

    def __init__(self, line: Line, outputs: int) -> None:
        self.line: Line = line
        self.outputs: int = outputs
        self.zero: bytes = zero_anywhere(outputs)
        self.lock: AbstractContextManager[bool] = threading.RLock()
        self._echo = bytes([outputs])
        self._losses, self._chips = 0, b""

    def connect(self, name: str) -> int:
        """Open the port, put any firmware at zero, and return its number of outputs. Another device
        than before gets nothing but a question."""
        line = self.line
        if not HAS_POSIX:
            raise BoardError(
                "this board goes on with its last pattern if its program hangs, and the watchdog "
                "that would put it at zero needs Linux or macOS: use simulated: here"
            )
        line.connect(name, self._watch)
        if line.reopened:
            if line.identity is None:
                self._recognize()
            self.watched.arm()
            line.write(self.zero)
        if line.identity is not None or not line.reopened:
            # Only a reset takes the time to boot.
            line.pause(kits.BOOT_S)
        capacity = self._identify()
        self.watched.arm()
        return capacity

    def _watch(self, port: Port) -> Port:
        self.watched = WatchedPort(port, self.zero)
        return self.watched

    # -- detection -----------------------------------------------------------

    def _answers(
        self, query: bytes, *attempts: tuple[bytes, float], then: tuple[bytes, ...] = ()
    ) -> Iterator[bytes]:
        """Yield the first byte of each answer to a query. Each attempt begins with bytes and a
        pause, which lead the parser to the start of a command."""
        for data, pause_s in attempts:
            self.line.write(data)
            self.line.pause(pause_s)
            for command in then:
                self.line.write(command)
            yield self.line.ask(query, 1, CHIPS_S)

    def _identify(self) -> int:
        """Put the board at zero and its parser at the start of a command; return its number of
        outputs, after its number of electrodes was set."""
        line = self.line
        # An earlier host may have left half a pattern, which any byte but zero would complete as a
        # current. What zeros do not end, a silence does.
        answers = self._answers(CHIPS, (ZEROS, 0.01), (ZEROS, FORGETS_S), then=AT_REST)
        if not (answer := next(filter(None, answers), b"")):
            raise SilentBoardError(
                f"the board at {line.name} does not answer as an eTactileKit does: check that it "
                "is on, and switch it off and on"
            )
        self._chips = answer
        capacity = 8 * answer[0]
        if self.outputs > capacity:
            raise BoardError(
                f"the eTactileKit at {line.name} has {capacity} outputs, the profile needs "
                f"{self.outputs}: use the profile of this board"
            )
        # Its number of electrodes is zero. The answer to the second byte shows whether the first
        # was a query.
        if b"\0" + answer not in (line.ask(PING + CHIPS, 2, CHIPS_S) for _ in range(LOOKS)):
            for command in AT_REST:
                line.write(command)
            raise BoardError(
                f"the eTactileKit at {line.name} does not echo: its firmware is older than commit "
                "71adee2, or damaged: flash the newest one of the kit's repository, "
                "aid-lab-org/eTactileKit"
            )
        # No sense pulses: the guard of every change relies on that.
        electrodes = bytes([0xFC, self.outputs])
        if line.ask(QUIET + NO_SENSE + electrodes + PING, 1, ECHO_S) != self._echo:
            raise line.lost("does not echo its number of electrodes")
        return capacity

    def _recognize(self) -> None:
        """Ask a device that has come back whether it is the same board, where USB does not tell."""
        # No zeros before the query: another device might act on them.
        answers = self._answers(CHIPS, (b"", 0.0), (b"", FORGETS_S))
        if received := next(filter(None, answers), b""):
            # A longer answer is another device's; zero waits only briefly for that.
            received += self.line.read(1, MORE_S)
        if received != self._chips:
            raise OtherDeviceError(
                f"what is at {self.line.name} now does not answer as that board did: nothing but "
                "this question was sent"
            )

    # -- queries -------------------------------------------------------------

    def exchange(
        self, body: bytes, *, ask: bool = False, drives: ProvedSequence | None = None
    ) -> tuple[Span, Readings] | None:
        """Send commands and wait until they are executed; return the span in which that was and, if
        asked for, the readings (N,) before them in the board's order. If the answer is wrong, lead
        the parser to the start of a command and return None. Commands that start the pulses of a
        sequence come with it, in ``drives``."""
        expected, begun_ns = 2 * self.outputs * ask + 1, self.line.now_ns()
        answer = self.line.ask(READINGS * ask + body + PING, expected, ECHO_S, drives)
        span = Span(begun_ns, self.line.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            self._resync()
            return None
        self._losses = 0
        return span, np.frombuffer(answer[:-1], "<u2")

    def _resync(self) -> None:
        """Resynchronize the board's parser to the start of a command; nothing flows meanwhile."""
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise BoardError(
                f"{self._losses} commands in a row were lost on the way to the eTactileKit at "
                f"{self.line.name}, so it cannot be driven safely: use another cable and port, or "
                "flash the newest firmware of the kit's repository, aid-lab-org/eTactileKit"
            )
        # Zeros complete any half pattern, and are no commands; if not, silence does. The answer may
        # only be late, and a silence would cost far more.
        query = QUIET + bytes(4) + PING
        if self._echo not in self._answers(query, (ZEROS, 0.01), (b"", FORGETS_S)):
            raise self.line.lost("does not answer any more")


BEAT_S = 0.02
ENDS_WITHIN_S = 1.5  # of the watchdog; zero for 253 outputs takes .4 s in small pieces
KEPT_MS = 100.0  # longest time from the end or hang of this program to the first byte of zero
STALE_NS = int(0.8e9 * watchdog.SILENCE_S)
"""Silence after which this program writes nothing more: no byte of it follows the zero of its
watchdog, which waits longer."""
COMMAND = [sys.executable, "-I", "-S", watchdog.__file__]
"""Of the watchdog; isolated: no user setting or package can keep it from starting."""


class WatchedPort:
    """Serial port or TCP connection that a `watchdog` puts at zero when this program is gone.

    It writes nothing once the watchdog has ended or may have run out of patience. POSIX only (tried
    on Linux).
    """

    def __init__(self, port: Port, zero: bytes) -> None:
        self.timeout: float | None = port.timeout
        self._port, self._zero = port, zero
        self._closing = threading.Event()
        self._beaten_ns: int | None = None  # time of the last heartbeat
        self._beating = threading.Thread(target=self._beat, name="watchdog heartbeat", daemon=True)
        self._control, control = socket.socketpair()
        try:
            with control:
                if not isinstance(port, (serial.Serial, protocol_socket.Serial)):
                    raise ValueError("it needs a serial device or tcp://HOST:PORT")
                ends = (int(port.fileno()), control.fileno())
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
    def at_zero(self) -> bool:
        """Whether the watchdog has ended and put the board at zero."""
        return self._process.poll() in (watchdog.GONE, watchdog.SILENT)

    def arm(self) -> None:
        """Let the watchdog put the board at zero from now on."""
        if self._beaten_ns is None:
            # If it has ended already, the next write says so.
            with contextlib.suppress(OSError):
                self._send_beat()
            self._beating.start()

    def write(self, data: bytes) -> int:
        """Write bytes; raise SerialException if the watchdog has ended or may write zero now.

        Where this program stood still just before the bytes went out, they may have followed the
        zero of the watchdog: then zero follows them at once.
        """
        self._require_beat(b"")
        self._port.write(data)
        # Twice, as the first may end a command that was cut.
        self._require_beat(2 * self._zero)
        return len(data)

    def _require_beat(self, or_write: bytes) -> None:
        if self._beaten_ns is None:
            return
        if self._is_stale() or self._process.poll() is not None:
            self._end()
            self._port.write(or_write)
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
        if self._beaten_ns is not None and not self.at_zero:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.write(self._zero)

    @prioritized()
    def _beat(self) -> None:
        # Where it is stale, the watchdog may be writing zero already.
        while not self._closing.wait(BEAT_S) and not self._is_stale():
            try:
                self._send_beat()
            except OSError:
                # It is gone; if it was killed, the board is not at zero yet.
                self._end()
                return

    def _send_beat(self) -> None:
        self._beaten_ns = now_ns()
        self._control.sendall(b".")

    def _is_stale(self) -> bool:
        # By a clock that also counts while the computer is suspended, where the system has one.
        return now_ns() - (self._beaten_ns or 0) > STALE_NS
