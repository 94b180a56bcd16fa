"""Senders of packets: programs of this user, or holders of a key in a file."""

import hmac
import os
import socket
import struct
import time
from collections import defaultdict
from collections.abc import Sequence
from enum import Enum, auto
from pathlib import Path
from typing import NamedTuple

from smarttouch.base.errors import SourceError
from smarttouch.base.files import open_file
from smarttouch.base.posix import user_number
from smarttouch.base.wire.socket_owners import UDP_TABLES, read_sockets

LEAST_KEY_BYTES = 16
_MOST_KEY_BYTES = 4096
_APART_NS = 10_000_000_000  # most difference between the clocks of sender and receiver
_MAC_BYTES, _TIME_BYTES = 32, 8
STAMP = getattr(socket, "SO_TIMESTAMPNS", 35)  # Linux's ``asm-generic/socket.h``
_STAMPED = struct.Struct("@ll")
_MOST_BYTES = 65_536
_MOST_AT_ONCE = 64


class Verdict(Enum):
    """Origin of a packet."""

    OURS = auto()
    NEW = auto()  # of a socket of ours that may be younger than the packet
    FOREIGN = auto()  # of another user, or of a socket that is closed again


class Packet(NamedTuple):
    """A packet, and when the system received it by the clock of the day."""

    data: bytes
    port: int
    received_ns: int


class OwnPrograms:
    """Sockets of this machine, by which packets of this user's programs are known. A packet is
    taken if its port has belonged to one user's sockets, ours, from before it came until now; so a
    foreign packet cannot wait for its port to become ours, and only the first packets of a new
    socket are lost."""

    def __init__(self) -> None:
        self._user = user_number()
        self._seen: dict[int, tuple[frozenset[tuple[int, int]], int]] = {}
        if not UDP_TABLES[0].exists():
            raise SourceError(
                f"this system has no {UDP_TABLES[0]}, which says whose program sends: give a key, "
                "as in osc:9000?key=FILE",
                about="key",
            )
        self.look()

    def look(self) -> None:
        """Read which sockets there are now; raise OSError if the system does."""
        every = list(read_sockets(UDP_TABLES))
        now_ns, before = time.time_ns(), self._seen
        sockets: dict[int, frozenset[tuple[int, int]]] = defaultdict(frozenset)
        for each in every:
            sockets[each.local[1]] |= {(each.user, each.number)}
        self._seen = {}
        for port, found in sockets.items():
            known, since_ns = before.get(port, (None, now_ns))
            self._seen[port] = found, since_ns if known == found else now_ns

    def verdict(self, packet: Packet) -> Verdict:
        """Return the origin of a packet that came before the last look."""
        sockets, since_ns = self._seen.get(packet.port, (frozenset(), 0))
        if {user for user, _ in sockets} != {self._user}:
            return Verdict.FOREIGN
        return Verdict.OURS if since_ns <= packet.received_ns else Verdict.NEW


class Key:
    """Secret in a file that authenticates packets. Each is HMAC-SHA256 (RFC 2104) of all that
    follows, the time in ns since 1970 in 8 bytes, big endian, and a packet of OSC. Times must
    increase, so that no packet counts twice."""

    def __init__(self, path: Path) -> None:
        with open_file(path, SourceError, _MOST_KEY_BYTES) as file:
            found, self._key = os.fstat(file.fileno()), file.read().strip()
        if found.st_uid != user_number() or found.st_mode & 0o077:
            raise SourceError(
                f"{path} can be read by others: write a new key to it, and chmod 600 {path}",
                about="key",
            )
        if len(self._key) < LEAST_KEY_BYTES:
            raise SourceError(
                f"{path} has a key of {len(self._key)} bytes: give at least {LEAST_KEY_BYTES}, as "
                "openssl rand -hex 32 writes them",
                about="key",
            )
        self._last_ns = 0

    def opened(self, data: bytes) -> bytes | None:
        """Return the packet of OSC in one made with the key; None for any other."""
        code, signed = data[:_MAC_BYTES], data[_MAC_BYTES:]
        if not hmac.compare_digest(code, hmac.digest(self._key, signed, "sha256")):
            return None
        sent_ns = int.from_bytes(signed[:_TIME_BYTES], "big")
        if sent_ns <= self._last_ns or abs(time.time_ns() - sent_ns) > _APART_NS:
            return None
        self._last_ns = sent_ns
        return signed[_TIME_BYTES:]


def received(line: socket.socket) -> Sequence[Packet]:
    """Return packets that wait; their time is 0 unless the socket has the option `STAMP`."""
    found = []
    for _ in range(_MOST_AT_ONCE):
        try:
            data, notes, _, sender = line.recvmsg(_MOST_BYTES, 64, socket.MSG_DONTWAIT)
        except OSError:
            break
        stamps = [_STAMPED.unpack(each) for _, kind, each in notes if kind == STAMP]
        received_ns = stamps[0][0] * 1_000_000_000 + stamps[0][1] if stamps else 0
        found.append(Packet(data, sender[1], received_ns))
    return found
