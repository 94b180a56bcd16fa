"""A small client of the link, from ``docs/reference/link.md`` alone: no code of the package."""

import struct
import zlib

from cobs import cobs

HELLO, SEQUENCE, HEARTBEAT, STOP, STATUS, BEGIN, LIMITS, KERNELS = range(1, 9)
OFFER, ACK, NAK, ALIVE, REPORT, STOPPED, VOLTAGES, BEGUN, LIMITED, KEPT = range(0x81, 0x8B)
E, FULL = 4, 65_535


def frame(kind, number, session, heard=0, about=0, payload=b""):
    body = struct.pack("<BBIBQII", 5, kind, number, 0, session, heard, about) + payload
    return cobs.encode(body + struct.pack("<I", zlib.crc32(body))) + b"\0"


def unframe(data):
    """Return kind, number, session, heard, about and payload of each sound packet."""
    found = []
    for piece in filter(None, data.split(b"\0")):
        try:
            body = cobs.decode(piece)
        except cobs.DecodeError:
            continue
        if len(body) >= 10 and zlib.crc32(body[:-4]) == int.from_bytes(body[-4:], "little"):
            if body[0] != 5 or len(body) < 27:
                body = body[:6].ljust(27, b"\0")
            _, kind, number, _, *rest = struct.unpack_from("<BBIBQII", body)
            found.append((kind, number, *rest, body[23:-4]))
    return found


class Client:
    """A host of weighted boards; ``exchange`` takes bytes to a board and returns its answer."""

    def __init__(self, exchange, half=0xC11E47):
        self._exchange, self._half = exchange, half
        self._number = self._heard = self._session = self._about = 0
        self.alive = 0

    def ask(self, kind, about=0, payload=b""):
        """Send a packet; return what comes, as kind, about and payload."""
        self._number += 1
        session = self._half if kind == HELLO else self._session
        packet = frame(kind, self._number, session, self._heard, about, payload)
        return self.take(self._exchange(packet))

    def take(self, data):
        found = []
        for kind, number, session, _, about, payload in unframe(data):
            if kind == OFFER and session & 0xFFFFFFFF == self._half:
                self._session = session
            elif session != self._session or number <= self._heard:
                continue
            else:
                self._heard = number
            self.alive += kind == ALIVE
            found.append((kind, about, payload))
        return found

    def open(self, limits):
        """Begin a session; return electrodes, slots and bytes that the board takes at once."""
        ((_, _, offer),) = self.ask(HELLO)
        self.electrodes, _, _, _, self.slots, *_ = struct.unpack_from("<HBBHHHH", offer)
        (self.bytes,) = struct.unpack_from("<I", offer, 16)
        assert [kind for kind, *_ in self.ask(BEGIN)] == [BEGUN]
        assert (LIMITED, b"\1") in [(kind, told) for kind, _, told in self.ask(LIMITS, 0, limits)]

    def parts(self, period_us, intensity, slots):
        """Return the payloads of slots of one shape: width, discharge, site, currents."""
        room = (self.bytes - 27 - 18) // (2 + 2 * self.electrodes)
        size = min(self.slots, room)
        for at in range(0, len(slots), size):
            some = slots[at : at + size]
            flags = 4 * (at + size < len(slots)) + 8 * (at > 0)
            head = struct.pack("<IHHBBHH", period_us, 1, intensity, flags, 1, *some[0][:2])
            rows = [struct.pack(f"<H{self.electrodes}h", site, *ua) for *_, site, ua in some]
            yield head + struct.pack("<BBH", 2, 0, len(some)) + b"".join(rows)

    def send(self, period_us, intensity, slots, wait):
        """Send a scan, each part when the one before has begun; return ACKs and NAKs."""
        answers = []
        for payload in self.parts(period_us, intensity, slots):
            self._about += 1
            found = self.ask(SEQUENCE, self._about, payload)
            while not any(kind in (ACK, NAK) and about == self._about for kind, about, _ in found):
                found += self.take(wait()) + self.ask(HEARTBEAT)
            answers += [kind for kind, about, _ in found if kind in (ACK, NAK)]
        return answers
