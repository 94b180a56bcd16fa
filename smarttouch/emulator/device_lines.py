"""Device end of a line for emulators: a pseudo-terminal, also of a recorded device, or TCP."""

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


def _written(number: int, data: bytes) -> bytes:
    """Write what fits; return the rest."""
    try:
        return data[os.write(number, data) :]
    except BlockingIOError:
        return data
    except OSError:
        return b""


class PtyLine:
    """Pseudo-terminal as a serial port of this machine."""

    def __init__(self) -> None:
        self._master, slave = pty.openpty()
        self.name: str = os.ttyname(slave)
        # Raw mode: bytes must pass unchanged even before the host configures the port.
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        # Close our copy of the slave, so that the host's last close appears as a hang-up.
        os.close(slave)

    def close(self) -> None:
        """Remove the port; the host sees a hang-up."""
        master, self._master = self._master, -1
        if master >= 0:
            os.close(master)

    def read(self, timeout_s: float) -> bytes | None:
        """Return the bytes received within the timeout, if any; None while there is no host."""
        if not select.select([self._master], [], [], timeout_s)[0]:
            return b""
        try:
            return os.read(self._master, LARGEST_READ)
        except BlockingIOError:
            # After a hang-up the port was readable, but the host has opened it again.
            return b""
        except OSError:
            time.sleep(0.002)
            return None

    def write(self, data: bytes) -> bytes:
        """Write what fits; return the rest."""
        return _written(self._master, data)


class TcpLine:
    """TCP port of this machine, for one host at a time."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=1)
        self.name: str = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._host: socket.socket | None = None

    def close(self) -> None:
        """Close both sockets."""
        self._listener.close()
        if self._host is not None:
            self._host.close()

    def read(self, timeout_s: float) -> bytes | None:
        """Return the bytes received within the timeout, if any; None while there is no host."""
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
        """Write what fits; return the rest."""
        return b"" if self._host is None else _written(self._host.fileno(), data)


@contextlib.contextmanager
def replayed(path: Path | str) -> Iterator[str]:
    """Give the name of a port during a block, where the device of a recording answers as it did.

    At its end, raises BoardError that names the first byte of the host that was not as recorded.
    """
    with contextlib.closing(Replay(Path(path))) as replay, ThreadPoolExecutor(1) as pool:
        served = pool.submit(replay.serve)
        try:
            yield replay.name
        finally:
            replay.ending.set()
            served.result()


class Replay(PtyLine):
    """Port of a recorded device; BoardError unless ``path`` is the recording of a `Line`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.ending: threading.Event = threading.Event()  # the host writes no more
        try:
            lines = map(json.loads, read_text(path, BoardError, MOST_BANK_BYTES).splitlines())
            self._events = [(line["event"], bytes.fromhex(line["hex"])) for line in lines]
        except (ValueError, KeyError, TypeError):
            raise BoardError(f"{path} is not the recording of a line: give one") from None
        super().__init__()

    def serve(self) -> None:
        """Answer as recorded once the host has written what was recorded before, until it closes
        the port. Raises BoardError with the position of the first other byte."""
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
        """Yield "" when a host opens the port, and then its bytes until it closes the port."""
        ending, data = False, None
        while data is None and not ending:
            # Keep this order: what the host wrote before the end is still read.
            ending, data = self.ending.is_set(), self.read(0.001)
        yield ""
        while data or (data is not None and not ending):
            yield from (f"{byte:02x}" for byte in data)
            ending, data = self.ending.is_set(), self.read(0.001)

    def _compare(self, position: int, heard: str, recorded: str) -> None:
        if heard != recorded:
            where = f"byte {position} from the host is {heard}, and was {recorded}"
            raise BoardError(f"{where} in {self._path}: compare them")
