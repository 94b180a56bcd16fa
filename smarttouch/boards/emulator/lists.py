"""Kernels and lists of them as an emulated board of ``link`` reads them.

Like its rules, written independently of the host, so that it checks what the host computes.
"""

import hashlib
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link_sequence import WireSequence, unpack_states

_HEAD = struct.Struct("<IHHBB")
_GROUP = struct.Struct("<BBH")
_PAIR = struct.Struct("<HH")
_NOTHING = bytes(16)
MOST_AMPLITUDE = 0xFFFF  # largest sum of a slot's amplitudes


@dataclass(frozen=True, eq=False)
class Group:
    """Slots of one kind and one pulse shape."""

    kind: int  # 0 points, 1 one sum, 2 currents, 3 states
    slots: int
    kernel: NDArray[np.int64]  # (N,) of points and sums
    amplitude: NDArray[np.int64]  # (N,)


@dataclass(frozen=True, eq=False)
class Lists:
    """Sequence as received, before kernels are looked up."""

    intensity: int
    groups: list[Group]
    sequence: WireSequence  # currents of points and sums are zero until kernels are looked up

    @property
    def slots(self) -> int:
        return len(self.sequence.width_us)


def decode_lists(payload: bytes, electrodes: int, switched: bool) -> Lists:
    """Return the sequence in a payload; raise ValueError if that is not exactly one."""
    if len(payload) < _HEAD.size:
        raise ValueError("too short")
    period_us, times, intensity, flags, count = _HEAD.unpack_from(payload)
    if not times or flags > 3 or (switched and flags & 2):
        raise ValueError("a head that is none")
    at = _HEAD.size + 4 * count
    shapes = np.frombuffer(_part(payload, _HEAD.size, at), "<u2").reshape(count, 2)
    recharge_us, recharge = 0, None
    if flags & 2:
        recharge_us = int.from_bytes(_part(payload, at, at + 2), "little")
        recharge = np.frombuffer(_part(payload, at + 2, at + 2 + 2 * electrodes), "<i2")
        at += 2 + 2 * electrodes
    groups, shape = [], []
    site, current, source, state = [], [], [], []
    packed = -(-electrodes // 4)
    nothing = np.empty(0, np.int64)
    while at < len(payload):
        kind, index, number = _GROUP.unpack(_part(payload, at, at + _GROUP.size))
        at += _GROUP.size
        if kind > 3 or index >= count or not number:
            raise ValueError("a group that is none")
        row = (4, 4, 2 + 2 * electrodes, 4 + packed)[kind]
        body = np.frombuffer(_part(payload, at, at + row * number), np.uint8).reshape(number, row)
        at += row * number
        slots, kernel, amplitude = 1 if kind == 1 else number, nothing, nothing
        empty = np.zeros((slots, electrodes), np.int16)
        if kind < 2:
            kernel, amplitude = _u16(body[:, :2]), _u16(body[:, 2:])
            site.append(np.zeros(slots, np.int64))
        else:
            site.append(_u16(body[:, :2]))
        current.append(np.ascontiguousarray(body[:, 2:]).view("<i2") if kind == 2 else empty)
        source.append(_u16(body[:, 2:4]) if kind == 3 else np.zeros(slots, np.int64))
        state.append(unpack_states(body[:, 4:], electrodes) if kind == 3 else empty)
        groups.append(Group(kind, slots, kernel, amplitude))
        shape += [index] * slots
    if not groups:
        current, state = [np.zeros((0, electrodes), np.int16)], [np.zeros((0, electrodes))]
        site = source = [nothing]
    sequence = WireSequence(
        period_us, times, bool(flags & 1), electrodes,
        shapes[shape, 0], shapes[shape, 1], np.concatenate(site).astype(np.uint16),
        None if switched else np.concatenate(current),
        np.concatenate(source).astype(np.uint16) if switched else None,
        np.concatenate(state).astype(np.int8) if switched else None,
        recharge, recharge_us,
    )  # fmt: skip
    return Lists(intensity, groups, sequence)


def _part(payload: bytes, start: int, end: int) -> bytes:
    if end > len(payload):
        raise ValueError("cut short")
    return payload[start:end]


def _u16(columns: NDArray[np.uint8]) -> NDArray[np.int64]:
    return np.ascontiguousarray(columns).view("<u2")[:, 0].astype(np.int64)


def summed(
    weights: NDArray[np.int16], kernel: NDArray[np.int64], amplitude: NDArray[np.int64]
) -> NDArray[np.int16]:
    """Return the current of every electrode in a slot, (E,) int16 µA: see the page of ``link``."""
    return rounded((weights[kernel].astype(np.int64) * amplitude[:, None]).sum(axis=0))


def rounded(every: NDArray[np.int64]) -> NDArray[np.int16]:
    """Return weights times amplitudes, (…, E), as currents in whole µA that sum to zero."""
    whole = (np.cumsum(every, axis=-1) + 65_536) // 131_072
    return np.diff(whole, axis=-1, prepend=0).astype(np.int16)


class Keep:
    """Kernels that a board keeps from one session to the next."""

    def __init__(self, electrodes: int, room: int, most: int) -> None:
        self._electrodes, self._room, self._most = electrodes, room, most
        self._data = bytearray()
        # First 16 bytes of the SHA-256 of what is being kept; zeros if nothing.
        self.identity, self.size = _NOTHING, 0
        self.weights: NDArray[np.int16] | None = None  # (K, E), once all of it is there
        self.site = np.zeros(0, np.uint16)  # (K,)

    @property
    def received(self) -> int:
        return len(self._data)

    def take(self, identity: bytes, size: int, offset: int, data: bytes) -> None:
        """Take a part of the kernels; one that does not continue the part before is dropped."""
        if (identity, size) != (self.identity, self.size):
            self._forget()
            if size > self._room:
                return
            self.identity, self.size = identity, size
        if self.weights is not None or offset != len(self._data):
            return
        if offset + len(data) > size:
            return
        self._data += data
        if len(self._data) == size:
            try:
                self._read(bytes(self._data))
            except ValueError:
                self._forget()

    def proof(self, session: int) -> bytes:
        """Return the digest that proves to a session's host which kernels are kept; zeros if they
        are not complete."""
        if self.weights is None:
            return _NOTHING
        return hashlib.sha256(session.to_bytes(8, "little") + self._data).digest()[:16]

    def _forget(self) -> None:
        self._data.clear()
        self.identity, self.size = _NOTHING, 0
        self.weights = None

    def _read(self, data: bytes) -> None:
        if hashlib.sha256(data).digest()[:16] != self.identity:
            raise ValueError("another identity")
        electrodes, count = _PAIR.unpack(_part(data, 0, 4))
        if electrodes != self._electrodes or count > self._most:
            raise ValueError("other electrodes, or too many kernels")
        weights, site = np.zeros((count, electrodes), np.int16), np.zeros(count, np.uint16)
        at = 4
        for index in range(count):
            site[index], runs = _PAIR.unpack(_part(data, at, at + 4))
            at, end = at + 4, 0
            for _ in range(runs):
                first, length = _PAIR.unpack(_part(data, at, at + 4))
                at += 4
                if first < end or not length or first + length > electrodes:
                    raise ValueError("a run that is none")
                end = first + length
                weights[index, first:end] = np.frombuffer(_part(data, at, at + 2 * length), "<i2")
                at += 2 * length
            if site[index] >= electrodes or int(weights[index].sum(dtype=np.int64)):
                raise ValueError("a kernel that is none")
            if (weights[index] == -32768).any():
                raise ValueError("a weight below all others")
        if at != len(data):
            raise ValueError("too long")
        self.weights, self.site = weights, site
