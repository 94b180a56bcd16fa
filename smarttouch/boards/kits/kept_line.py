"""Line held by a keeper process, which puts the board at zero when its host is gone."""

import contextlib
import select
import socket
import subprocess
import sys
import threading
import time

import serial
from serial.urlhandler import protocol_socket

from smarttouch.base.clock import prioritized
from smarttouch.base.errors import BoardError
from smarttouch.base.wire.port import LINE_ERRORS, Port, reason
from smarttouch.boards.kits import keeper

BEAT_S = 0.02
ANSWER_S = 2.0  # longest time of the keeper's start or answer
ENDS_WITHIN_S = 1.5  # of the keeper; zero for 253 outputs takes .4 s in small pieces
WRITE_S = 0.5
COMMAND = [sys.executable, "-I", "-S", keeper.__file__]
"""Of the keeper; isolated: no user setting or package can keep it from starting."""

_WHY = {
    keeper.SILENT: "this program stood still for more than "
    f"{1000 * keeper.SILENCE_S:g} ms, so its keeper put the board at zero",
    keeper.LINE_LOST: "the line broke",
    keeper.BLOCKED: "the board takes no bytes",
    keeper.ENDED: "its keeper was ended, and put the board at zero before",
}
_AT_ZERO = (keeper.GONE, keeper.SILENT, keeper.ENDED)


class KeptLine:
    """Serial port or TCP connection behind a `keeper`: the interface of a port, and `promise_zero`.

    The port is opened by this program, which reports errors, and handed to the keeper. It keeps its
    own descriptor to write zero if the keeper is killed. POSIX only (tried on Linux).
    """

    def __init__(self, port: Port) -> None:
        self.timeout: float | None = port.timeout
        self._port, self._zero = port, b""
        self._closing = threading.Event()
        try:
            self._start()
        except OSError as error:
            raise BoardError(
                f"the process that keeps the board's line cannot be started ({reason(error)}): "
                "close other programs and try again"
            ) from None

    def _start(self) -> None:
        with contextlib.ExitStack() as ours, contextlib.ExitStack() as its:
            ours.callback(self._let_go)
            self._data, there = socket.socketpair()
            ours.enter_context(self._data)
            its.enter_context(there)
            self._control, controlled = socket.socketpair()
            ours.enter_context(self._control)
            its.enter_context(controlled)
            ends = (_descriptor(self._port), there.fileno(), controlled.fileno())
            self._process = subprocess.Popen(
                [*COMMAND, *map(str, ends)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, cwd="/", pass_fds=ends, start_new_session=True,
            )  # fmt: skip
            # From here on `close` ends what has begun.
            ours.pop_all()
        self._data.settimeout(WRITE_S)
        self._control.setblocking(False)
        self._beating = threading.Thread(target=self._beat, name="keeper heartbeat", daemon=True)
        self._beating.start()

    @property
    def process_id(self) -> int:
        return self._process.pid

    @property
    def at_zero(self) -> bool:
        """True if the keeper has ended and reported the board at zero."""
        return self._process.poll() in _AT_ZERO

    def promise_zero(self, zero: bytes) -> None:
        """Set the keeper's zero command, valid at any point of the byte stream, and start its
        silence timer."""
        self._zero = zero
        head = keeper.ZERO + len(zero).to_bytes(2, "little")
        try:
            self._control.sendall(head + zero)
        except OSError:
            raise self._gone() from None

    def write(self, data: bytes) -> int:
        """Write bytes through the keeper; raise SerialException if it has ended."""
        try:
            self._data.sendall(data)
        except TimeoutError:
            raise serial.SerialTimeoutException("the board takes no bytes") from None
        except OSError:
            raise self._gone() from None
        return len(data)

    def read(self, count: int = 1) -> bytes:
        """Return as many bytes as come within ``timeout``, at most ``count``."""
        deadline = time.monotonic() + (self.timeout or 0.0)
        read = b""
        while len(read) < count:
            left = max(0.0, deadline - time.monotonic())
            if not select.select([self._data], [], [], left)[0]:
                break
            read += self._receive(count - len(read))
        return read

    def reset_input_buffer(self) -> None:
        """Drop all input from the board, in the keeper too."""
        try:
            self._control.sendall(keeper.FLUSH)
            if not select.select([self._control], [], [], ANSWER_S)[0]:
                raise serial.SerialException("its keeper does not answer")
            if not self._control.recv(1):
                raise self._gone()
        except ConnectionError:
            raise self._gone() from None
        while select.select([self._data], [], [], 0)[0]:
            self._receive(65536)

    def close(self) -> None:
        """Put the board at zero by the keeper, end it, and close the port."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._beating.join(ANSWER_S)
        self._data.close()
        self._control.close()
        try:
            self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._put_at_zero()
        self._let_go()

    def _let_go(self) -> None:
        with contextlib.suppress(*LINE_ERRORS):
            self._port.close()

    @prioritized()
    def _beat(self) -> None:
        while not self._closing.wait(BEAT_S):
            try:
                self._control.send(keeper.HEARTBEAT)
            except BlockingIOError:
                # The socket is full: the waiting bytes show that this program lives.
                continue
            except OSError:
                # It is gone; if it was killed, the board is not at zero yet.
                self._gone()
                return

    def _receive(self, most: int) -> bytes:
        try:
            data = self._data.recv(most)
        except OSError:
            data = b""
        if not data:
            raise self._gone()
        return data

    def _gone(self) -> serial.SerialException:
        """Return why the keeper has ended, and put the board at zero if it could not."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(ANSWER_S)
        self._put_at_zero()
        why = _WHY.get(self._process.poll() or 0, "its keeper was killed")
        return serial.SerialException(why)

    def _put_at_zero(self) -> None:
        """Write zero from this process if the keeper was killed, or failed."""
        if self._process.poll() not in (None, keeper.GONE, *_WHY) and self._port.is_open:
            with contextlib.suppress(*LINE_ERRORS):
                self._port.write(self._zero)


def _descriptor(port: Port) -> int:
    if not isinstance(port, (serial.Serial, protocol_socket.Serial)):
        raise BoardError(
            "this board continues by itself when its program is gone, so a process of its own "
            "must hold the line, which is possible for a serial device or tcp://HOST:PORT only"
        )
    return int(port.fileno())


KEPT_MS = 100.0  # longest time from the end or hang of this program to the first byte of zero
