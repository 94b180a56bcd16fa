"""Keeper: a small process that holds a board's line and sends zero when its host is gone.

Boards that run freely repeat their last pattern when the program that drives them is killed. So
that program writes not to the port but to a keeper, which relays every byte, both ways. When the
program ends, however it ends, its end of the line closes; when it hangs or is stopped, its
heartbeats stop. Either way the keeper writes this board's zero command, closes the port and ends.

It runs in a session of its own (Ctrl-C, a closed terminal and a kill of the host's process group
do not reach it), and imports only the standard library, so that it starts within some 20 ms. The
host's side is `kept_line`.

Three file descriptors are given on the command line: the port, ``data`` (a socket that carries
the board's bytes both ways) and ``control`` (a socket with messages of the host)::

    b"."                         a heartbeat
    b"F"                         drop what has come from the board; answered by b"F"
    b"Z" u16 N, N bytes          zero command

Silence counts from the first ``Z`` on: nothing sent before can make current. A suspended computer
counts as a silent host.
"""

import contextlib
import os
import select
import signal
import sys
import time

SILENCE_S = 0.09  # longest silence of the host: with the time to wake up and write, .1 s to zero
PRIORITY = 2  # real-time, where allowed: above the host's 1, so a hung host cannot block it
STUCK_S = 0.4  # without a byte accepted while zero is written: the board is stuck
PIECE, PAUSE_S = 8, 0.003  # zero goes out once more in pieces, of which a busy USB chip loses none
GONE, SILENT, LINE_LOST, BLOCKED, ENDED = 7, 3, 4, 5, 6
"""Exit codes: the host has closed, or was silent; the line broke, or takes no bytes; SIGTERM.
None is 0, which a host that ignores SIGCHLD reads of any process, killed ones too."""
HEARTBEAT, FLUSH, ZERO = b".", b"F", b"Z"
ZERO_HEAD = 3
_MOST = 65536
_MOST_READS = 100


class Keeper:
    """Relay between a host and a port, by their file descriptors, until one of them is gone."""

    def __init__(self, port: int, data: int, control: int) -> None:
        self._port, self._data, self._control = port, data, control
        self._zero = b""
        self._unread = b""
        self._to_port = self._to_host = b""
        self._ended = False
        for each in (port, data, control):
            os.set_blocking(each, False)

    def end(self, *_: object) -> None:
        """Request the end of `run`, and nothing else, as signal handlers call it."""
        self._ended = True

    def run(self) -> int:
        """Relay until host, port or process end, and put the board at zero unless its line fails;
        return the exit code."""
        code = LINE_LOST
        try:
            code = self._pass_bytes()
        except OSError:
            # Only the port raises here: the host's end shows as a closed one.
            pass
        finally:
            if not self._write_zero() and code != LINE_LOST:
                code = BLOCKED
        return code

    def _pass_bytes(self) -> int:
        active_s, slept = time.monotonic(), _slept_s()
        while not self._ended:
            # A direction with bytes waiting is not read; control always is.
            reading = [self._control]
            reading += [] if self._to_port else [self._data]
            reading += [] if self._to_host else [self._port]
            writing = [self._port] if self._to_port else []
            writing += [self._data] if self._to_host else []
            left = active_s + SILENCE_S - time.monotonic()
            ready, room, _ = select.select(reading, writing, [], max(0.0, left))
            if self._zero and _slept_s() > slept + SILENCE_S:
                return SILENT
            if self._control in ready or self._data in ready:
                active_s = time.monotonic()
            elif self._zero and (left <= 0 or not (ready or room)):
                # Checked after the wait: a keeper that was delayed itself may still find bytes.
                return SILENT
            elif not ready and not room:
                active_s = time.monotonic()
            if self._control in ready and not self._listen():
                return GONE
            if self._data in ready:
                self._to_port = _read(self._data)
                if not self._to_port:
                    return GONE
            if self._to_port:
                self._to_port = _write(self._port, self._to_port)
            if self._port in ready and not self._to_host:
                self._to_host = self._read_port()
            if self._to_host:
                try:
                    self._to_host = _write(self._data, self._to_host)
                except OSError:
                    return GONE
        return ENDED

    def _listen(self) -> bool:
        """Handle the host's messages; return whether it is still there."""
        message = _read(self._control)
        self._unread += message
        while self._unread:
            kind = self._unread[:1]
            if kind == ZERO:
                length = ZERO_HEAD + int.from_bytes(self._unread[1:3], "little")
                if len(self._unread) < max(length, ZERO_HEAD):
                    break
                self._zero, self._unread = self._unread[ZERO_HEAD:length], self._unread[length:]
                continue
            self._unread = self._unread[1:]
            if kind == FLUSH:
                self._to_host = b""
                # A device may never stop sending.
                for _ in range(_MOST_READS):
                    if not self._read_port():
                        break
                try:
                    os.write(self._control, FLUSH)
                except OSError:
                    return False
        return bool(message)

    def _read_port(self) -> bytes:
        """Return the board's bytes; raise OSError if the line is lost."""
        # A flush may have read the bytes.
        if not select.select([self._port], [], [], 0)[0]:
            return b""
        data = os.read(self._port, _MOST)
        if not data:
            raise OSError("the line is closed")
        return data

    def _write_zero(self) -> bool:
        """Write the zero command twice, the second time in small pieces, as older firmware loses
        bytes that come fast; return whether the line accepted it."""
        for slow in (False, True):
            step = PIECE if slow else _MOST
            for start in range(0, len(self._zero), step):
                piece = self._zero[start : start + step]
                while piece:
                    try:
                        if not select.select([], [self._port], [], STUCK_S)[1]:
                            return False
                        piece = _write(self._port, piece)
                    except OSError:
                        return False
                if slow:
                    time.sleep(PAUSE_S)
        return True


def _slept_s() -> float:
    """Return the time for which the computer was suspended, s, up to a constant."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return 0.0 if clock is None else time.clock_gettime(clock) - time.monotonic()


def _read(end: int) -> bytes:
    """Return the host's bytes; empty if it is gone."""
    try:
        return os.read(end, _MOST)
    except OSError:
        return b""


def _write(end: int, data: bytes) -> bytes:
    """Write as many bytes as fit; return the rest."""
    try:
        return data[os.write(end, data) :]
    except BlockingIOError:
        return data


def _go_first() -> None:
    """Set a priority above the host and ordinary programs, where the system allows that."""
    with contextlib.suppress(AttributeError, OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def main() -> None:
    """Run the keeper on the port, data and control ends numbered by the command line."""
    _go_first()
    keeper = Keeper(*(int(number) for number in sys.argv[1:4]))
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, keeper.end)
    sys.exit(keeper.run())


if __name__ == "__main__":
    main()
