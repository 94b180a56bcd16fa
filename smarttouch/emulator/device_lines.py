"""Device end of a line for emulators: a pseudo-terminal or a TCP connection."""

import contextlib
import os
import select
import socket
import time

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
