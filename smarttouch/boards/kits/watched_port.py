"""Port that this program shares with a `watchdog` process."""

import contextlib
import socket
import subprocess
import sys
import threading
import time

import serial
from serial.urlhandler import protocol_socket

from smarttouch.base.errors import BoardError
from smarttouch.base.posix import HAS_POSIX, prioritized
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards.kits import watchdog

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
