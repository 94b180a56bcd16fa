"""Owners of this machine's sockets, from the tables of Linux.

See https://www.kernel.org/doc/html/latest/networking/proc_net_tcp.html. A user's sockets are listed
with the user; a connection within the machine is listed twice, once from each end.
"""

import contextlib
import re
import socket
import struct
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from smarttouch.base.posix import user_number

UDP_TABLES = (Path("/proc/net/udp"), Path("/proc/net/udp6"))
TCP_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_ENTRY = re.compile(
    rb"^ *\d+: ([0-9A-F]+):([0-9A-F]{4}) ([0-9A-F]+):([0-9A-F]{4})(?: \S+){4} +(\d+) +\d+ +(\d+) ",
    re.MULTILINE,
)

_MAPPED = b"0000000000000000FFFF0000"  # of addresses of IPv4 in the tables of IPv6

Address = tuple[bytes, int]  # address as in the tables, and port


class SocketEntry(NamedTuple):
    """One socket of a table."""

    local: Address
    remote: Address
    user: int
    number: int  # unique while it is open; 0 for one that its program has closed


def read_sockets(tables: Iterable[Path]) -> Iterator[SocketEntry]:
    """Yield all sockets; raises OSError if the system does."""
    for table in tables:
        if table.exists():
            for local, at, remote, to, user, number in _ENTRY.findall(table.read_bytes()):
                local, remote = (each.removeprefix(_MAPPED) for each in (local, remote))
                yield SocketEntry(
                    (local, int(at, 16)), (remote, int(to, 16)), int(user), int(number)
                )


def is_from_us(line: socket.socket) -> bool:
    """Return whether the other end of a connection is a program of this user on this machine."""
    if line.family == getattr(socket, "AF_UNIX", None):
        option = line.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        return bool(struct.unpack("3i", option)[1] == user_number())
    return _are_ours(_address(line.getpeername()), _address(line.getsockname()))


def own_sockets() -> frozenset[int]:
    """Return the numbers of all sockets of this process."""
    found = set()
    for each in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            target = each.readlink().name
            if target.startswith("socket:["):
                found.add(int(target[8:-1]))
    return frozenset(found)


def lead_to_us(numbers: Collection[int]) -> bool:
    """Return whether all connections of these sockets end in programs of this user on this machine,
    and there is one."""
    every = list(read_sockets(TCP_TABLES))
    mine = [each for each in every if each.number in numbers and each.remote[1]]
    return bool(mine) and all(_are_ours(each.remote, each.local, every) for each in mine)


def _are_ours(
    local: Address, remote: Address, sockets: Iterable[SocketEntry] | None = None
) -> bool:
    """Return whether a socket of these addresses is this user's."""
    every = read_sockets(TCP_TABLES) if sockets is None else sockets
    found = {
        each.user for each in every if (each.local, each.remote) == (local, remote) and each.number
    }
    return found == {user_number()}


def _address(place: tuple[str, int]) -> Address:
    kind = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
    packed = socket.inet_pton(kind, place[0].partition("%")[0])
    # Words of 32 bits in the machine's own order.
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return "".join(f"{each:08X}" for each in words).encode(), place[1]
