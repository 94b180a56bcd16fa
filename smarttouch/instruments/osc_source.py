"""``osc:``: images and points from other programs, by Open Sound Control over UDP.

They are programs of this user, or hold a key in a file.
"""

import hmac
import ipaddress
import os
import re
import select
import socket
import struct
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError
from smarttouch.base.files import open_file
from smarttouch.base.lazy_names import import_extra
from smarttouch.base.posix import user_number
from smarttouch.instruments.pushed_stimuli import LOOK_S, UDP_TABLES, PushedStimuli, read_sockets
from smarttouch.profile import Profile

LEAST_KEY_BYTES = 16
_MOST_KEY_BYTES = 4096
_APART_NS = 10_000_000_000  # most difference between the clocks of sender and receiver
_MAC_BYTES, _TIME_BYTES = 32, 8
STAMP = getattr(socket, "SO_TIMESTAMPNS", 35)  # Linux's ``asm-generic/socket.h``
_STAMPED = struct.Struct("@ll")
_MOST_BYTES = 65_536
_MOST_AT_ONCE = 64


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

    def are_sending(self, packet: Packet) -> bool | None:
        """Return whether a packet that came before the last look is of this user; None of a socket
        that may be younger than the packet, False of another user or a socket that is closed."""
        sockets, since_ns = self._seen.get(packet.port, (frozenset(), 0))
        if {user for user, _ in sockets} != {self._user}:
            return False
        return True if since_ns <= packet.received_ns else None


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


MOST_PIXELS = 1_000_000
_SIGNED = "/smarttouch/signed"


def open_osc(
    rest: str, profile: Profile, key: Path | None = None, *, follow: bool = False
) -> "OscSource":
    """Open ``osc:PORT``, which listens on 127.0.0.1, or ``osc:ADDRESS:PORT?key=FILE``.

    With ``follow`` each packet is one pulse, see `PushedStimuli`.
    """
    host, _, port = rest.rpartition(":")
    if not re.fullmatch(r"\d{1,5}", port) or not 0 < int(port) < 65536:
        raise SourceError(
            f"{rest!r} is no place to listen at: give osc:PORT or osc:ADDRESS:PORT, as in osc:9000",
            about="address",
        )
    return OscSource(profile, host.strip("[]") or "127.0.0.1", int(port), key, follow)


class OscSource(PushedStimuli):
    """Source of what arrives as messages; half a second of silence is an empty pattern.

    ========================================  ==================================================
    ``/smarttouch/electrodes`` levels         of all electrodes: numbers, or a blob of bytes
    ``/smarttouch/image`` width height grey   row by row, bright is active: numbers, or a blob
    ``/smarttouch/point`` x y [level [mm]]    from the top left, 0 to 1; within a radius if given
    ``/smarttouch/clear``                     no electrode is active
    ========================================  ==================================================

    Numbers are from 0 to 1, bytes from 0 to 255. All classes of afferents get what a message says;
    one does with its name in the address, as in ``/smarttouch/sai/point``. Each packet is a pattern
    of its own: points and classes of one bundle belong together.

    Without a key, packets of programs of this user on this machine are taken and no others, see
    `OwnPrograms`. With the key of a file, needed where other machines can send, each comes within
    ``/smarttouch/signed``, a blob: see `Key`. `wrong` counts packets that were not understood,
    `refused` those of others.
    """

    def __init__(
        self, profile: Profile, host: str, port: int, key: Path | None = None, follow: bool = False
    ) -> None:
        self._parse = _import_parser()
        self._key = None if key is None else Key(key)
        self._programs = OwnPrograms() if key is None else None
        super().__init__(f"OSC at {host}:{port}", profile, follow)
        self.refused: int = 0
        self._electrodes = profile.electrodes
        self._line = _bound(host, port, alone=key is None)
        self._thread.start()

    def close(self) -> None:
        super().close()
        self._line.close()
        self._note_wrong("OSC packets were invalid")
        if self.refused:
            self.notes.append(
                f"{self.refused} OSC packets were refused: they were of other users, of programs "
                "that had closed their socket, or without the key"
            )
            self.refused = 0

    def receive(self) -> None:
        waits = select.select([self._line], [], [], LOOK_S)[0]
        packets = received(self._line) if waits else ()
        if self._programs is not None:
            try:
                self._programs.look()
            except OSError:
                self.refused += len(packets)
                return
        for each in packets:
            self._admit(each)

    def _admit(self, packet: Packet) -> None:
        """Take a packet from a program that may send."""
        if self._programs is not None:
            ours = self._programs.are_sending(packet)
            self.refused += ours is False
            if ours:
                self._take(packet.data)
        elif self._key is not None:
            data = self._unsigned(packet.data)
            if data is None:
                self.refused += 1
            else:
                self._take(data)

    def _unsigned(self, data: bytes) -> bytes | None:
        try:
            ((address, (blob,)),) = self._parse(data)
        except Exception:  # whatever the parser makes of what anybody may send
            return None
        if address != _SIGNED or not isinstance(blob, bytes) or self._key is None:
            return None
        return self._key.opened(blob)

    def _take(self, data: bytes) -> None:
        """Take the messages of one packet, all or none."""
        levels = np.zeros((len(Afferent), len(self._electrodes)), np.float32)
        try:
            messages = self._parse(data)
            if not messages:
                raise ValueError(data)
            for address, values in messages:
                self._change(levels, address, values)
        except Exception:  # whatever the parser makes of what a program may send
            self.wrong += 1
            return
        self.push(levels)

    def _change(self, levels: NDArray[np.float32], address: str, values: Sequence[Any]) -> None:
        """Change the activation of one class or of all by a message."""
        *named, kind = address.removeprefix("/smarttouch/").split("/")
        (rows,) = [slice(None)] if not named else [Afferent[each.upper()] for each in named]
        if kind == "clear":
            levels[rows] = 0
        elif kind == "electrodes":
            levels[rows] = _numbers(values, len(self._electrodes))
        elif kind == "image":
            width, height = int(values[0]), int(values[1])
            if not (width > 0 and height > 0 and width * height <= MOST_PIXELS):
                raise ValueError(values[:2])
            image = _numbers(values[2:], width * height).reshape(height, width)
            levels[rows] = self._sampled(image)
        elif kind == "point":
            levels[rows] = np.maximum(levels[rows], self._point(*map(float, values)))
        else:
            raise ValueError(address)

    def _sampled(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean of an image over the cell of each electrode; it fills the array."""
        wide, high = self._electrodes.extent_mm
        cell_x, cell_y = self._electrodes.cell_mm
        columns, rows = (
            4 * max(1, round(all_mm / mm)) for all_mm, mm in ((wide, cell_x), (high, cell_y))
        )
        fine = cv2.resize(
            image,
            (columns, rows),
            interpolation=cv2.INTER_AREA if image.shape[0] > rows else cv2.INTER_NEAREST,
        )
        mean = cv2.blur(fine, (4, 4), borderType=cv2.BORDER_REPLICATE)
        x, y = (self._electrodes.position_mm / (wide, high) + 0.5).T
        at_x = np.clip(np.rint(x * columns), 0, columns - 1).astype(int)
        at_y = np.clip(np.rint(y * rows), 0, rows - 1).astype(int)
        return np.asarray(mean[at_y, at_x], np.float32)

    def _point(
        self, x: float, y: float, level: float = 1.0, radius_mm: float | None = None
    ) -> NDArray[np.float32]:
        """Return the electrodes within a radius of a place; the nearest if none is given."""
        if not (0 <= x <= 1 and 0 <= y <= 1 and 0 <= level <= 1):
            raise ValueError((x, y, level))
        place = (np.array([x, y]) - 0.5) * self._electrodes.extent_mm
        away = np.linalg.norm(self._electrodes.position_mm - place, axis=1)
        on = away <= (away.min() if radius_mm is None else float(radius_mm))
        return np.asarray(on * np.float32(level), np.float32)


def _numbers(values: Sequence[Any], count: int) -> NDArray[np.float32]:
    """Return ``count`` numbers from 0 to 1, given as such or as a blob of bytes."""
    blob = len(values) == 1 and isinstance(values[0], bytes)
    given = np.frombuffer(values[0], np.uint8) / 255 if blob else np.array(values, np.float64)
    found = np.asarray(given, np.float32)
    if found.shape != (count,) or not ((found >= 0) & (found <= 1)).all():
        raise ValueError(count)
    return found


def _bound(host: str, port: int, alone: bool) -> socket.socket:
    """Return a socket at an address, which other machines may reach only if it is not for this one
    alone."""
    try:
        kind, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        if alone and not ipaddress.ip_address(str(place[0]).partition("%")[0]).is_loopback:
            raise SourceError(
                f"any program that reaches {host} could send: give a key, as in "
                f"osc:{host}:{port}?key=FILE, or the port alone",
                about="key",
            )
        line = socket.socket(kind, socket.SOCK_DGRAM)
        try:
            if alone:
                line.setsockopt(socket.SOL_SOCKET, STAMP, 1)
            line.bind(place)
        except OSError:
            line.close()
            raise
    except (OSError, UnicodeError) as error:
        raise SourceError(
            f"cannot listen at {host}:{port}: {getattr(error, 'strerror', None) or error}; give "
            "another port, as in osc:9001",
            about="address",
        ) from None
    return line


def _import_parser() -> Any:
    packet: Any = import_extra("pythonosc.osc_packet", "osc:", "osc", SourceError).OscPacket

    def parse(data: bytes) -> list[tuple[str, list[Any]]]:
        return [(each.message.address, each.message.params) for each in packet(data).messages]

    return parse
