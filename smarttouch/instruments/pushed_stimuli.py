"""Activations that other programs send: the newest wins; and whose programs they are."""

import contextlib
import re
import socket
import struct
import threading
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.posix import user_number
from smarttouch.profile import Profile
from smarttouch.running.session_feed import SessionFeed
from smarttouch.sources.source_contract import Input, Stimulus

SILENT_S = 0.5  # silence after which an activation is stale
LOOK_S = 0.1  # longest wait of the receiving thread, which then looks whether it is to end
_JOIN_S = 1.0


class PushedStimuli(SessionFeed):
    """Source of activations that arrive by themselves; half a second of silence is an empty one.

    One that follows none or an empty one is read at once, the others with the next sequence, and
    pulses keep the profile's rates. With ``follow``, and where all three classes are driven, which
    have no rates of their own, each is read at once, in as far as the profile's limit allows, and
    is one pulse of every active class; the last is repeated at the profile's rate until it is
    stale.
    """

    fixed_mode = True
    stands_still = False
    ended = "the source has ended"

    def __init__(self, title: str, profile: Profile, follow: bool = False) -> None:
        super().__init__(profile, title)
        self.given: int = 0  # number of activations that came so far
        self.wrong: int = 0  # number of those that were left out, as they were invalid
        self._follow, self._closing = follow, False
        self._thread = threading.Thread(target=self._receive_all, name="received", daemon=True)
        self.put(np.zeros((len(Afferent), len(profile.electrodes)), np.float32), 0)
        self._put_sent_ns = 0

    @abstractmethod
    def receive(self) -> None:
        """Wait for at most `LOOK_S`, and `push` what has come; called by a thread of its own."""

    def _receive_all(self) -> None:
        while not self._closing:
            self.receive()

    def close(self) -> None:
        self._closing = True
        self._thread.join(_JOIN_S)

    def _note_wrong(self, words: str) -> None:
        """Add a note on how many were left out, and why."""
        if self.wrong:
            self.notes.append(f"{self.wrong} {words}")
            self.wrong = 0

    def push(self, activation: NDArray[np.float32]) -> None:
        """Take an activation, (3, E) in [0, 1], that is not written to again."""
        self.put(activation, round(1e9 * SILENT_S))
        self.given += 1

    @property
    def follows(self) -> bool:
        """Whether each begins at once."""
        return self._follow or len(self.afferents) == len(Afferent)

    def read(self, time_ns: int) -> Input | None:
        """Return what came last, of the classes that are driven; stale after a silence."""
        given = super().read(time_ns)
        if not isinstance(given, Stimulus):
            return given
        driven, rows = np.zeros_like(given.activation), list(self.afferents)
        driven[rows] = given.activation[rows]
        return replace(given, activation=driven)


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
