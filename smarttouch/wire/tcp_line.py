"""TCP port as a device, for emulators."""

import select
import socket

from smarttouch.wire.pty_line import LARGEST_READ


class TcpLine:
    """A TCP port of this machine, for one host at a time, never unplugged; it answers ``ETK?`` on
    the UDP port ``discovery_port``."""

    keeps_name = False
    plugged_in = True

    def __init__(self, discovery_port: int | None = None) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=1)
        self._port = int(self._listener.getsockname()[1])
        self.name = f"tcp://127.0.0.1:{self._port}"
        self._host: socket.socket | None = None
        self._watched = [self._listener]
        if discovery_port is not None:
            self._watched.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._watched[1].bind(("127.0.0.1", discovery_port))

    def read(self, timeout_s: float) -> bytes | None:
        """Return what has come, empty if nothing; None while there is no host."""
        line = self._host or self._listener
        ready = select.select([line, *self._watched[1:]], [], [], timeout_s)[0]
        for discovery in ready:
            if discovery in self._watched[1:]:
                self._answer_discovery(discovery)
        if self._host is None:
            if line not in ready:
                return None
            self._host = self._listener.accept()[0]
            self._host.setblocking(False)
            self._host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return b""
        try:
            data = self._host.recv(LARGEST_READ)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if data:
            return data
        self._host.close()
        self._host = None
        return None

    def write(self, data: bytes) -> bytes:
        """Write what fits; return the rest."""
        try:
            return b"" if self._host is None else data[self._host.send(data) :]
        except BlockingIOError:
            return data
        except OSError:
            return b""

    def plug_in(self) -> None: ...

    def pull_out(self) -> None: ...

    def close(self) -> None:
        """Close all sockets."""
        for each in (self._host, *self._watched):
            if each is not None:
                each.close()

    def _answer_discovery(self, discovery: socket.socket) -> None:
        question, sender = discovery.recvfrom(64)
        if question.strip() == b"ETK?":
            busy = int(self._host is not None)
            answer = (
                f"ETK!;id=A1B2C3;name=emulator;ip=127.0.0.1;port={self._port};mode=STA;"
                f"busy={busy};fw=1.0"
            )
            discovery.sendto(answer.encode(), sender)
