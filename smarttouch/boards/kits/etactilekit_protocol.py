"""Line to an eTactileKit: commands, dialogues, recovery from lost bytes, and watchdog.

On the wire (native USB, or TCP port 8080; little endian, no framing, no checksum)::

    FC u8   electrodes N        FB u8   0 monophasic, 1 biphasic, 2 impedance only
    FD u8   1 anodic 0 cathodic FA u16  pulse width µs
    F9 u8   sense height        F8 u8   sense width µs
    F7 u8   discharge µs        F6 u16  scans per second
    FE N×u16 heights in counts  FF      reply N×u16: ADC of each electrode's last slot
    F5      reply: chips        F4      reply: N, the only echo

This is the protocol of commit 71adee2 and later. Older firmware has no F4 and one height for all
electrodes (FB); its FE N×u8 selects electrodes. Such boards are set to zero and rejected.

If a byte of the heights after FE is lost, the next byte on the wire takes its place. The later
heights are then shifted by eight bits, and currents can reach 41 mA. Therefore the driver stops
pulses before each change, sends a query after the change, and restarts pulses only after the
answer. If a byte is lost, the board reads the query as data. Then there is no answer and no pulse,
and the driver resets the parser. The driver avoids numbers with bytes that look like commands.
Zeros follow each 16-bit number: if one of its bytes is lost, a zero becomes the high byte, so the
number only becomes smaller. Doubled bytes are not detected, but do not occur on USB and TCP.
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
"""Largest count that the driver sends, about 10 mA. The firmware accepts up to 4095, 41 mA."""
FIRST_COMMAND = 0xF4
SHORTEST_US = 7  # shortest pulse: switching takes 6.6 µs

Readings = NDArray[np.uint16]


@dataclass(frozen=True)
class Settings:
    """Settings for all slots of a scan."""

    width_us: int
    discharge_us: int
    rate_hz: int
    anodic: bool

    @property
    def period_ns(self) -> int:
        """Period of the board's timer, rounded to µs."""
        return 1_000_000 // self.rate_hz * 1000

    def scan_us(self, outputs: int, slot_extra_us: int = 10) -> int:
        return outputs * (self.width_us + self.discharge_us + slot_extra_us)

    def commands(self, between_hz: int) -> bytes:
        """Return the commands that replace the board's settings by these, each command twice. Zeros
        follow each command, so that a lost byte never lengthens a pulse. Until all settings are
        replaced, the scan rate is ``between_hz``: slow enough for the old and the new settings."""
        once = (
            QUIET + _END + b"\xf9\0" + _END + b"\xf8\0" + _END
            + b"\xf6" + between_hz.to_bytes(2, "little") + _END
            + bytes([0xFD, self.anodic]) + _END
            + b"\xfa" + self.width_us.to_bytes(2, "little") + _END
            + bytes([0xF7, self.discharge_us]) + _END
        )  # fmt: skip
        return once * 2 + (b"\xf6" + self.rate_hz.to_bytes(2, "little") + _END) * 2


ZEROS = bytes(2 * 255 + 4)  # completes any incomplete command
PING, CHIPS, READINGS = b"\xf4", b"\xf5", b"\xff"
NO_SENSE = b"\xf9\0\0\xf8\0\0"
_END = bytes(3)  # completes any command that has lost a byte
AT_REST = (
    b"\xfc\0" + _END, NO_SENSE, b"\xfb\0\0" + _END, b"\xfa\x01\0" + _END,
    b"\xf7\0" + _END, b"\xf6\x0a\0" + _END,
)  # fmt: skip
"""Commands that set a board with any published firmware to zero: 0 electrodes, no sense pulses,
height 0 (in newer firmware, mode 0), the shortest pulses and 10 scans per second. Other known
boards read these bytes neither as a query nor as a pattern."""
QUIET = b"\xfb\x02\xfb\x02"  # stops pulses at the next scan
LOAD = b"\xfb\x02\xfe"  # stops pulses; the bytes of a new pattern must follow
GO = b"\xfb\0"  # starts pulses at the next scan


def zero_anywhere(outputs: int) -> bytes:
    """Return the bytes that set a board to zero in any state of its parser.

    If the board is in the middle of a command, the first zeros complete the command, and can only
    make its value smaller. The other bytes stop all pulses and load zeros. There are more zeros
    than necessary, because some may be lost.
    """
    return bytes(2 * outputs + 4) + NO_SENSE + b"\xfb\x02\x02\x02\xfe" + bytes(2 * outputs)


@dataclass(frozen=True)
class Span:
    """Earliest and latest possible time of an event, ns."""

    early: int
    late: int


ECHO_S = 0.1  # longest wait for the answer to PING
CHIPS_S = 0.5  # longest wait for the answer to CHIPS
MORE_S = 0.03  # wait for additional bytes: USB chips hold bytes for 16 ms
FORGETS_S = 2.15  # pause after which the board drops a partial command
MOST_LOSSES = 4  # largest number of lost commands in a row; after more, the board is not safe
LOOKS = 5  # attempts to get an echo; if all fail, the firmware counts as too old


class ETactileKitLine:
    """Dialogues with an eTactileKit.

    Without a host the board repeats its last pattern, so the watchdog is armed before any command
    that can cause current. ``lock`` is held during a dialogue, so that no zero command comes
    between a query and its answer.
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
        """Open the port, set a board with any firmware to zero, and return its number of outputs.
        After a lost connection, another device at the port receives at most a query."""
        line = self.line
        if not HAS_POSIX:
            raise BoardError(
                "this board is safe only with a watchdog, which needs Linux or macOS: on this "
                "computer, use a simulated board (simulated:)"
            )
        line.connect(name, self._watch)
        if line.reopened:
            if line.identity is None:
                self._recognize()
            self.watched.arm()
            line.write(self.zero)
        if line.identity is not None or not line.reopened:
            # Opening the port may reset the board, so wait until it has booted.
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
        """Yield the first byte of the answer to each attempt, given as (bytes, time in s). Send the
        bytes, wait for this time to resynchronize the parser, and send ``then`` and ``query``."""
        for data, pause_s in attempts:
            self.line.write(data)
            self.line.pause(pause_s)
            for command in then:
                self.line.write(command)
            yield self.line.ask(query, 1, CHIPS_S)

    def _identify(self) -> int:
        """Set the board to zero and tell it how many outputs to scan. Return how many it has."""
        line = self.line
        # An earlier host may have left an incomplete pattern. Only zeros complete it without
        # current. If zeros do not complete it, the board drops it during a pause.
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
                f"the eTactileKit at {line.name} has {capacity} outputs, but the profile needs "
                f"{self.outputs}: use the profile of this board"
            )
        # AT_REST has set the number of electrodes to 0, so PING returns 0. Older firmware has no
        # PING and answers only CHIPS.
        if b"\0" + answer not in (line.ask(PING + CHIPS, 2, CHIPS_S) for _ in range(LOOKS)):
            for command in AT_REST:
                line.write(command)
            raise BoardError(
                f"the eTactileKit at {line.name} does not echo: its firmware is damaged, or older "
                "than commit 71adee2. Flash the newest firmware of the kit's repository, "
                "aid-lab-org/eTactileKit"
            )
        # Turn off sense pulses, because QUIET stops only the other pulses.
        electrodes = bytes([0xFC, self.outputs])
        if line.ask(QUIET + NO_SENSE + electrodes + PING, 1, ECHO_S) != self._echo:
            raise line.lost("does not echo its number of electrodes")
        return capacity

    def _recognize(self) -> None:
        """Check by a query that a device without USB identity is the board that was lost."""
        # Do not send zeros before the query: another device might act on them.
        answers = self._answers(CHIPS, (b"", 0.0), (b"", FORGETS_S))
        if received := next(filter(None, answers), b""):
            # A longer answer is from another device; wait only briefly for more bytes.
            received += self.line.read(1, MORE_S)
        if received != self._chips:
            raise OtherDeviceError(
                f"the device at {self.line.name} is not the lost board, and only a query was sent "
                "to it: connect the lost board again"
            )

    # -- queries -------------------------------------------------------------

    def exchange(
        self, body: bytes, *, ask: bool = False, drives: ProvedSequence | None = None
    ) -> tuple[Span, Readings] | None:
        """Send commands and wait for their execution. Return the time of execution and, with
        ``ask``, the readings from before the commands, (N,), by output. After a wrong answer,
        resynchronize and return None. ``drives`` is the sequence that the commands start."""
        expected, begun_ns = 2 * self.outputs * ask + 1, self.line.now_ns()
        answer = self.line.ask(READINGS * ask + body + PING, expected, ECHO_S, drives)
        span = Span(begun_ns, self.line.now_ns())
        if len(answer) != expected or answer[-1:] != self._echo:
            self._resync()
            return None
        self._losses = 0
        return span, np.frombuffer(answer[:-1], "<u2")

    def _resync(self) -> None:
        """Resynchronize the board's parser, and stop pulses."""
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise BoardError(
                f"{self._losses} commands in a row were lost on the way to the eTactileKit at "
                f"{self.line.name}, so it cannot be driven safely: use another cable and port, or "
                "flash the newest firmware of the kit's repository, aid-lab-org/eTactileKit"
            )
        # First send zeros, which are not commands. They fill up a pattern that arrived in part. If
        # there is still no answer, pause until the board drops the partial pattern.
        query = QUIET + bytes(4) + PING
        if self._echo not in self._answers(query, (ZEROS, 0.01), (b"", FORGETS_S)):
            raise self.line.lost("does not answer any more")


BEAT_S = 0.02
ENDS_WITHIN_S = 1.5  # longest wait until the watchdog has ended; its zero command may take 0.4 s
BYTES_PER_MS = 92  # bytes that a serial line of 921,600 Bd transmits in 1 ms
KEPT_MS = 100.0  # the watchdog begins to write within this time after this program ends or hangs
STALE_NS = int(0.8e9 * watchdog.SILENCE_S)
"""Largest age of the last heartbeat, ns, at which this program still writes more than zeros. The
watchdog begins to write later, at an age of `watchdog.SILENCE_S`."""
COMMAND = [sys.executable, "-I", "-S", watchdog.__file__]
"""Command that starts the watchdog. Isolated mode ignores the settings and packages of the user,
which could prevent the start."""


class WatchedPort:
    """Serial port or TCP connection with a `watchdog`, which sets the board to zero when this
    program is gone.

    The port rejects writes if the watchdog has ended or may be writing zeros. POSIX only (tested on
    Linux).
    """

    def __init__(self, port: Port, zero: bytes) -> None:
        self.timeout: float | None = port.timeout
        self._port, self._zero = port, zero
        self._armed, self._closing = threading.Event(), threading.Event()
        self._beaten_ns: int | None = None  # time of the last heartbeat
        self._beating = threading.Thread(target=self._beat, name="watchdog heartbeat", daemon=True)
        self._control, control = socket.socketpair()
        try:
            with control:
                if not isinstance(port, (serial.Serial, protocol_socket.Serial)):
                    raise ValueError("the port must be a serial device or tcp://HOST:PORT")
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
                "the board would repeat its last pattern when this program ends"
            ) from None

    @property
    def at_zero(self) -> bool:
        """Whether the watchdog process has set the board to zero and ended."""
        return self._process.poll() in (watchdog.GONE, watchdog.SILENT)

    @property
    def left_to_watchdog(self) -> bytes:
        """Bytes that the watchdog wrote before it ended."""
        return 2 * self._zero if self.at_zero and self._beaten_ns is not None else b""

    def arm(self) -> None:
        """Arm the watchdog by the first heartbeat."""
        if self._beaten_ns is None:
            self._beating.start()
            self._armed.wait()

    def write(self, data: bytes) -> int:
        """Write bytes.

        Raises SerialException if the watchdog has ended or may be setting the board to zero. If
        this program pauses just before the write, ``data`` may reach the board after the zero
        command of the watchdog. This method then repeats the zero command at once.
        """
        self._require_beat(b"")
        self._port.write(data)
        # If too late, write zero twice: the first may be read as the end of an incomplete command.
        self._require_beat(2 * self._zero)
        return len(data)

    def _require_beat(self, or_write: bytes) -> None:
        if self._beaten_ns is None:
            return
        if self._is_stale() or self._process.poll() is not None:
            self._end()
            self._port.write(or_write)
            raise serial.SerialException(
                "this program was paused, so its watchdog set the board to zero"
                if self.at_zero
                else "its watchdog has ended"
            )

    def read(self, count: int = 1) -> bytes:
        """Return the bytes received within ``timeout``, at most ``count``."""
        self._port.timeout = self.timeout
        return bytes(self._port.read(count))

    def reset_input_buffer(self) -> None:
        """Drop all input from the board."""
        self._port.reset_input_buffer()

    def close(self) -> None:
        """Let the watchdog set the board to zero and end; close the port."""
        if self._closing.is_set():
            return
        self._closing.set()
        if self._beating.ident:
            self._beating.join()
        self._end()
        with contextlib.suppress(*LINE_ERRORS):
            self._port.close()

    def _end(self) -> None:
        """Let the watchdog set the board to zero and end. If it fails, send the zero command."""
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
        # This thread also sends the first heartbeat. A busy computer could delay this thread until
        # it has its priority, and the armed watchdog would not wait for so long.
        while True:
            try:
                self._send_beat()
            except OSError:
                # The watchdog is gone. If it was killed, the board is not at zero yet.
                self._end()
                return
            finally:
                self._armed.set()
            # After a pause, send no heartbeat: the watchdog may be writing the zero command.
            if self._closing.wait(BEAT_S) or self._is_stale():
                return

    def _send_beat(self) -> None:
        self._beaten_ns = now_ns()
        self._control.sendall(b".")

    def _is_stale(self) -> bool:
        # This clock includes suspended time if the system supports it.
        return now_ns() - (self._beaten_ns or 0) > STALE_NS
