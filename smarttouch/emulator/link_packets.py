"""Sessions, kernels and sequences of the ``link`` protocol in an emulated board.

The code is independent of the host's, so that an error in either shows up as a difference."""

import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.wire.framing import HEAD, WirePacket
from smarttouch.boards import link as protocol
from smarttouch.boards.link import HALF, LATE_MS, SUM, VERSION, Message, MessageKind, Refusal

MOST_HOSTS = 8  # number of hosts whose HELLO packets are remembered
_MS = 1_000_000
_PAIR = struct.Struct("<HH")
_NOTHING = bytes(16)


def decode_head(head: bytes) -> Message:
    """Decode the first `WHOLE_HEAD_BYTES` of a message, before its CRC has arrived."""
    version, kind, number = HEAD.unpack_from(head)
    return protocol.decode(WirePacket(kind, number, head[HEAD.size :], version))


def encode_volts(volts: NDArray[np.float64]) -> bytes:
    """Return the payload of VOLTAGES from the voltage of the source in each slot, (S,) V."""
    return np.clip(np.rint(volts * protocol.VOLT), 0, 0xFFFF).astype("<u2", copy=False).tobytes()


class BoardSession:
    """Newest session, and the challenge that opens the next session. ``draw`` returns 32 random
    bits, which are not all 0."""

    def __init__(self, draw: Callable[[], int] = protocol.draw_half) -> None:
        self.state = 0  # state of the board, which it sends in each packet
        self.number: int = 0  # number of the session; 0 before the first
        self.old: int = 0  # number of packets refused as old
        self.foreign: int = 0  # number of packets refused because they are from another session
        self.live: bool = False  # whether the session is open
        self._draw = draw
        self._challenge = draw()
        self._taken = self._said = 0
        self._alive: deque[tuple[int, int]] = deque(maxlen=2 + LATE_MS // protocol.ALIVE_MS)
        """For each of the last ALIVE packets: its time, ns, and its number."""
        self._hellos: dict[int, tuple[int, int]] = {}
        """For each host: number of its last HELLO or BEGIN; HELLO packets answered since BEGIN."""

    def encode(self, kind: MessageKind, about: int = 0, payload: bytes = b"") -> bytes:
        """Return the next packet of the board in the session."""
        self._said += 1
        message = Message(kind, self._said, self.number, self._taken, about, payload, self.state)
        return protocol.encode(message)

    def encode_alive(self, payload: bytes, now_ns: int) -> bytes:
        """Return the next ALIVE packet; store its time, so that `_refusal_of` detects delays."""
        packet = self.encode(MessageKind.ALIVE, 0, payload)
        self._alive.append((now_ns, self._said))
        return packet

    def answer_hello(self, hello: Message, capabilities: bytes) -> bytes | None:
        """Return the answer to a HELLO, or None if the HELLO is refused."""
        half = hello.session & HALF
        if self.live:
            self.foreign += 1
            return None
        if hello.version == VERSION:
            last, count = self._hellos.get(half, (0, 0))
            if hello.number <= last:
                self.old += 1
                return None
            if not last and len(self._hellos) == MOST_HOSTS:
                self._count_foreign_hellos()
            self._hellos[half] = hello.number, count + 1
        session = self._challenge << 32 | half
        kind = MessageKind.CAPABILITIES
        return protocol.encode(Message(kind, 0, session, 0, hello.number, capabilities, self.state))

    def would_begin(self, begin: Message) -> bool:
        """Return whether BEGIN may open a session."""
        fits = begin.session >> 32 == self._challenge and bool(begin.session & HALF)
        return not self.live and fits and begin.version == VERSION

    def refuse_begin(self, begin: Message, payload: bytes) -> bytes:
        """Return the NAK for a BEGIN that is refused."""
        nak = Message(MessageKind.NAK, 0, begin.session, 0, begin.number, payload, self.state)
        return protocol.encode(nak)

    def begin(self, begin: Message) -> None:
        """Open the session that a BEGIN requests; `would_begin` must be true for the BEGIN."""
        half = begin.session & HALF
        self._hellos.pop(half, None)
        self._count_foreign_hellos()
        self._hellos[half] = begin.number, 0
        self._challenge = self._draw()
        self.number, self.live = begin.session, True
        self._taken, self._said = begin.number, 0
        self._alive.clear()

    def _count_foreign_hellos(self) -> None:
        self.foreign += sum(count for _, count in self._hellos.values())
        self._hellos.clear()

    def take(self, message: Message, began_ns: int) -> Refusal | None:
        """Accept a packet whose first byte came at ``began_ns``, or return why it is refused."""
        refusal = self._refusal_of(message, began_ns)
        self.old += refusal is Refusal.OLD
        self.foreign += refusal is Refusal.FOREIGN
        if refusal is None:
            self._taken = message.number
        return refusal

    def is_sign_of_life(self, head: bytes, began_ns: int, now_ns: int) -> bool:
        """Return whether an incomplete SEQUENCE or KERNELS packet counts as a sign of life."""
        message, early = decode_head(head), now_ns - began_ns <= protocol.LONGEST_PACKET_MS * _MS
        fresh = self._refusal_of(message, began_ns) is None
        return message.kind in (MessageKind.SEQUENCE, MessageKind.KERNELS) and early and fresh

    def _refusal_of(self, message: Message, began_ns: int) -> Refusal | None:
        if message.version != VERSION or not self.number or message.session != self.number:
            return Refusal.FOREIGN
        # Each packet of the host confirms the newest packet of the board that the host received.
        # An ALIVE is stale if the board sent it more than `LATE_MS` before the host's packet began
        # to arrive. The host's packet is late if it confirms nothing newer than a stale ALIVE.
        stale = (number for sent_ns, number in self._alive if sent_ns < began_ns - LATE_MS * _MS)
        # STOP is never late: it must work even if the host receives nothing.
        late = message.kind != MessageKind.STOP and message.heard <= max(stale, default=-1)
        return Refusal.OLD if late or message.number <= self._taken else None


@dataclass(frozen=True, eq=False)
class ReceivedSequence:
    """Received sequence of S slots, with P pairs of kernel and amplitude. ``recharge_ua`` has shape
    (E,); it is None without a recharge phase."""

    period_us: int
    times: int
    intensity: int
    measure: bool
    more: bool  # whether the scan continues in the next sequence
    goes_on: bool  # whether this sequence continues the scan of the previous one
    recharge_us: int
    recharge_ua: NDArray[np.int64] | None
    kind: NDArray[np.int64]  # (S,): type of slot: 0 point, 1 sum, 2 currents, 3 states
    site: NDArray[np.int64]
    source_ua: NDArray[np.int64]  # (S,): current of the source, on switched boards
    width_us: NDArray[np.int64]
    discharge_us: NDArray[np.int64]
    rows: NDArray[np.int64]
    """(S, E): currents, µA, positive cathodic; in slots that list kernels, the currents are 0 until
    `LinkRules` computes them. On switched boards, the rows are states instead of currents: 1
    cathode, −1 anode, 0 insulated, 2 invalid."""
    pairs: NDArray[np.int64]  # (P, 3): slot, kernel and amplitude, sorted by slot

    @property
    def slots(self) -> int:
        return len(self.width_us)


class _Reader:
    """Reader of the values in a payload, in order. Raises ValueError if the payload is short."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    def take(self, size: int) -> bytes:
        start, self.at = self.at, self.at + size
        if self.at > len(self._data):
            raise ValueError("cut short")
        return self._data[start : self.at]

    def numbers(self, count: int, kind: str) -> NDArray[np.int64]:
        return np.frombuffer(self.take(2 * count), kind).astype(np.int64)


def decode_lists(payload: bytes, electrodes: int, switched: bool) -> ReceivedSequence:
    """Decode the payload of SEQUENCE. Raises ValueError if the payload is malformed."""
    rest = _Reader(payload)
    first = rest.take(protocol.SEQUENCE.size)
    period_us, times, intensity, flags, count = protocol.SEQUENCE.unpack(first)
    recharges, part = flags & protocol.RECHARGE, flags & (protocol.MORE | protocol.GOES_ON)
    wrong = (times > 1 and part) or (recharges and (switched or flags & protocol.MORE))
    if not times or flags > 15 or wrong:
        raise ValueError("an invalid head")
    shapes = rest.numbers(2 * count, "<u2").reshape(count, 2)
    recharge_us = int(rest.numbers(1, "<u2")[0]) if recharges else 0
    recharge_ua = rest.numbers(electrodes, "<i2") if recharges else None
    slots, heads, rows = 0, [np.empty((0, 4), np.int64)], [np.empty((0, electrodes), np.int64)]
    pairs = [np.empty((0, 3), np.int64)]
    while rest.at < len(payload):
        kind, shape, number = protocol.GROUP.unpack(rest.take(protocol.GROUP.size))
        if kind > protocol.STATES or shape >= count or not number:
            raise ValueError("an invalid group")
        size = (4, 4, 2 + 2 * electrodes, 4 + -(-electrodes // 4))[kind]
        body = np.frombuffer(rest.take(size * number), np.uint8).reshape(number, size)
        head = np.zeros((1 if kind == SUM else number, 4), np.int64)  # kind, shape, site, source
        row = np.zeros((len(head), electrodes), np.int64)
        head[:, :2] = kind, shape
        if kind <= SUM:
            slot = slots + np.arange(number) * (kind != SUM)
            pairs.append(np.column_stack([slot, body.view("<u2")]))
        elif kind == protocol.STATES:
            head[:, 2:] = body[:, :4].copy().view("<u2")
            row[:] = unpack_states(body[:, 4:], electrodes)
        else:
            head[:, 2:3] = body[:, :2].copy().view("<u2")
            row[:] = body[:, 2:].copy().view("<i2")
        slots += len(head)
        heads.append(head)
        rows.append(row)
    if part and not slots:
        raise ValueError("a part of a scan has no slots")
    kinds, shape, site, source_ua = np.concatenate(heads).T
    width_us, discharge_us = shapes[shape].T
    return ReceivedSequence(
        period_us, times, intensity, bool(flags & protocol.MEASURE), bool(flags & protocol.MORE),
        bool(flags & protocol.GOES_ON), recharge_us, recharge_ua, kinds, site, source_ua, width_us,
        discharge_us, np.concatenate(rows), np.concatenate(pairs),
    )  # fmt: skip


def unpack_states(packed: NDArray[np.uint8], electrodes: int) -> NDArray[np.int8]:
    """Return the state of each electrode, (S, E): 1 cathode, −1 anode, 0 insulated, 2 invalid."""
    bits = np.unpackbits(packed, axis=1, count=2 * electrodes, bitorder="little")
    codes = bits.reshape(len(packed), electrodes, 2) @ np.array([1, 2])
    return np.asarray(np.array([0, 1, -1, 2], np.int8)[codes])


def rounded(sums: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert sums of scaled kernels, (…, E), to whole µA, so that all currents sum to zero."""
    # Round cumulative sums, and return the differences of successive sums. The last cumulative sum
    # stays 0, so the differences add up to 0.
    return np.diff((np.cumsum(sums, axis=-1) + 65_536) >> 17, axis=-1, prepend=0)


class KernelStore:
    """Kernels that a board stores, even after the end of a session."""

    def __init__(self, electrodes: int, room: int, most: int) -> None:
        self._electrodes, self._room, self._most = electrodes, room, most
        self._forget()

    def _forget(self) -> None:
        self._data, self._size = bytearray(), 0
        self.identity: bytes = _NOTHING  # hash of the stored kernels; zeros if there are none
        self.weights: NDArray[np.int16] | None = None  # (K, E); None until all are received
        self.site: NDArray[np.uint16] = np.zeros(0, np.uint16)  # (K,)

    @property
    def received(self) -> int:
        return len(self._data)

    @property
    def count(self) -> int:
        """Number of kernels; 0 until all are received."""
        return len(self.site)

    def take(self, identity: bytes, size: int, offset: int, data: bytes) -> None:
        """Store a piece of the kernels; ignore it if it does not continue the stored bytes."""
        if (identity, size) != (self.identity, self._size):
            self._forget()
            if size > self._room:
                return
            self.identity, self._size = identity, size
        end = offset + len(data)
        if self.weights is not None or offset != len(self._data) or end > size:
            return
        self._data += data
        if end == size:
            try:
                self.weights, self.site = self._read()
            except ValueError:
                self._forget()

    def proof(self, session: int) -> bytes:
        """Return a digest that proves to the host which kernels are stored. All its bytes are 0
        until all kernels are received."""
        return _NOTHING if self.weights is None else protocol.digest_of(bytes(self._data), session)

    def _read(self) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        data, of = bytes(self._data), self._electrodes
        rest = _Reader(data)
        electrodes, count = _PAIR.unpack(rest.take(4))
        if protocol.digest_of(data) != self.identity or electrodes != of or count > self._most:
            raise ValueError("wrong identity, wrong number of electrodes, or too many kernels")
        weights, site = np.zeros((count, of), np.int16), np.zeros(count, np.uint16)
        for index in range(count):
            site[index], runs = _PAIR.unpack(rest.take(4))
            end = 0
            for _ in range(runs):
                first, length = _PAIR.unpack(rest.take(4))
                if first < end or not length or first + length > of:
                    raise ValueError("an invalid run")
                end = first + length
                weights[index, first:end] = rest.numbers(length, "<i2")
        uneven = weights.sum(axis=1, dtype=np.int64).any() or (weights == -32768).any()
        if rest.at < len(data) or uneven or (site >= of).any():
            raise ValueError("an invalid kernel")
        return weights, site
