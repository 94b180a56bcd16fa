"""Ports of emulated devices: a pseudo-terminal, a TCP port, and the replay of a recorded device."""

import contextlib
import json
import os
import select
import socket
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from smarttouch.base.errors import BoardError
from smarttouch.base.files import MOST_BANK_BYTES, read_text
from smarttouch.base.posix import pty, tty

LARGEST_READ = 65536


def _write_available(descriptor: int, data: bytes) -> bytes:
    """Write the bytes that fit into the buffer; return the rest. Drop all bytes on an error."""
    try:
        return data[os.write(descriptor, data) :]
    except BlockingIOError:
        return data
    except OSError:
        return b""


class PtyLine:
    """Pseudo-terminal, which a host on this computer opens like a serial port."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        self.name: str = os.ttyname(slave)
        # Raw mode: bytes must pass unchanged even before the host configures the port.
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        # Close the slave here: otherwise a host that closes the port would cause no hang-up.
        os.close(slave)

    def close(self) -> None:
        """Remove the port; the host sees a hang-up."""
        master, self._master = self._master, -1
        if master >= 0:
            os.close(master)

    def read(self, timeout_s: float) -> bytes | None:
        """Return the bytes received within the timeout, possibly none; None without a host."""
        if not select.select([self._master], [], [], timeout_s)[0]:
            return b""
        try:
            return os.read(self._master, LARGEST_READ)
        except BlockingIOError:
            # `select` reported a hang-up, but the host has reopened the port since.
            return b""
        except OSError:
            time.sleep(0.002)
            return None

    def write(self, data: bytes) -> bytes:
        """Write the bytes that fit into the buffer; return the rest."""
        return _write_available(self._master, data)


class TcpLine:
    """TCP port that accepts connections from this computer, one host at a time."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=1)
        self.name: str = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._host: socket.socket | None = None

    def close(self) -> None:
        """Close the port and the connection to the host."""
        self._listener.close()
        if self._host is not None:
            self._host.close()

    def read(self, timeout_s: float) -> bytes | None:
        """Return the bytes received within the timeout, possibly none; None without a host."""
        ready = select.select([self._host or self._listener], [], [], timeout_s)[0]
        if self._host is None:
            if not ready:
                return None
            self._host = self._listener.accept()[0]
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        if not ready:
            return b""
        with contextlib.suppress(OSError):
            if data := self._host.recv(LARGEST_READ):
                return data
        self._host.close()
        self._host = None
        return None

    def write(self, data: bytes) -> bytes:
        """Write the bytes that fit into the buffer; return the rest. Without a host, drop them."""
        return b"" if self._host is None else _write_available(self._host.fileno(), data)


@contextlib.contextmanager
def replayed(path: Path | str) -> Iterator[str]:
    """Replay a recorded device during a ``with`` block, which gets the name of its port.

    At the end of the block, raises BoardError if bytes from the host differ from the recording."""
    with contextlib.closing(Replay(Path(path))) as replay, ThreadPoolExecutor(1) as pool:
        served = pool.submit(replay.serve)
        try:
            yield replay.name
        finally:
            replay.ending.set()
            served.result()


class Replay(PtyLine):
    """Port that replays a recorded device. Raises BoardError if ``path`` is not a recording."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.ending: threading.Event = threading.Event()  # set when the host has stopped writing
        try:
            lines = map(json.loads, read_text(path, BoardError, MOST_BANK_BYTES).splitlines())
            self._events = [(line["event"], bytes.fromhex(line["hex"])) for line in lines]
        except (ValueError, KeyError, TypeError):
            message = f"{path} is not a recorded device: give a file made with ?record=FILE"
            raise BoardError(message) from None
        super().__init__()

    def serve(self) -> None:
        """Send each recorded answer after the host has sent the bytes recorded before it. Return
        when the host closes the port. Raises BoardError at the first byte that differs."""
        host: Iterator[str] = iter(())
        position = 0
        for event, data in self._events:
            if event == "opened":
                self._compare(position, next(host, "none"), "none")
                host = self._host_bytes()
                next(host)
            elif event == "received":
                while (data := self.write(data)) and not self.ending.wait(0.001):
                    pass
            else:
                for byte in data:
                    self._compare(position, next(host, "none"), f"{byte:02x}")
                    position += 1
        self._compare(position, next(host, "none"), "none")

    def _host_bytes(self) -> Iterator[str]:
        """Yield "" when a host opens the port, then each byte of the host in hexadecimal."""
        ending, data = False, None
        while data is None and not ending:
            # Check `ending` before reading: bytes that came before the end are still read.
            ending, data = self.ending.is_set(), self.read(0.001)
        yield ""
        while data or (data is not None and not ending):
            yield from (f"{byte:02x}" for byte in data)
            ending, data = self.ending.is_set(), self.read(0.001)

    def _compare(self, position: int, received: str, recorded: str) -> None:
        if received != recorded:
            where = f"byte {position} from the host is {received}, but {recorded} in {self._path}"
            raise BoardError(f"{where}: repeat the recorded commands, or record the line again")
