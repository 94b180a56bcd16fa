"""Kernels, sequences and limits as payloads of ``link``: see ``docs/reference/link.md``."""

import hashlib
import math
import struct
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import IDENTITY_BYTES, pack_states, source_of
from smarttouch.stimulation.quantized_kernels import kept_kernels
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence, bytes_of


@dataclass(frozen=True, eq=False)
class KernelImage:
    """The kernels of a run, as bytes for a board."""

    table: KernelTable
    own: KernelTable  # the same, backed by bytes that stay whatever becomes of the table
    count: int  # kernels that the board has room for: the first of the table
    data: bytes
    identity: bytes  # first 16 bytes of the SHA-256 of ``data``

    @classmethod
    def of(cls, table: KernelTable, room: int, most: int) -> Self:
        """Return as many kernels as there is room for, in bytes and in number."""
        flat = np.frombuffer(bytes_of(table.weights), np.int16)
        site_of = np.frombuffer(table.site.tobytes(), np.uint16)
        own = KernelTable(flat.reshape(table.weights.shape), site_of, {}, {})
        data, count = kept_kernels(own.weights, own.site, room, most)
        return cls(table, own, count, data, digest_of(data))

    def proof(self, session: int) -> bytes:
        """Return what a board that keeps just these kernels answers in a session."""
        return digest_of(session.to_bytes(8, "little") + self.data)


def digest_of(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()[:IDENTITY_BYTES]


_HEAD = struct.Struct("<IHHBB")
_GROUP = struct.Struct("<BBH")
_I16 = np.dtype("<i2")
POINTS, SUM, CURRENTS, STATES = range(4)  # kinds of groups of slots
FULL = 0xFFFF  # intensity 1
MEASURE, RECHARGE, MORE, GOES_ON = 1, 2, 4, 8
_MOST_SHAPES = 0xFF
_U16_MAX = 0xFFFF


def encode_limits(limits: SafetyLimits) -> bytes:
    """Return the payload of LIMITS: nothing in it allows more than the limits do."""
    part, whole = limits.duty_ratio
    head = protocol.LIMITS.pack(
        limits.period_us, limits.total_ua, limits.pulse_whole_us, math.ceil(limits.full_ua),
        math.ceil(limits.rounding_ua), math.ceil(limits.full_us or 0),
        math.ceil(limits.ramp_ns / 1e6), min(_U16_MAX, math.ceil(limits.session_s)),
        math.ceil(1000 * limits.session_mc), math.ceil(100 * part / whole),
        0, limits.width_whole_us,
    )  # fmt: skip
    each = (limits.current_ua, "<u2"), (limits.felt_ua, "<u2"), (limits.charge_pc, "<u4")
    return head + b"".join(values.astype(kind).tobytes() for values, kind in each)


class ScanPart(NamedTuple):
    """Part of a scan, which is all of it where the board has room for that."""

    payload: bytes
    first: int  # slot of the scan with which it begins
    slots: int
    start_us: int  # start of its slots within the scan


def encode_scan(
    sequence: ScanSequence,
    times: int,
    measure: bool,
    switched: bool,
    image: KernelImage | None,
    most_bytes: int,
    most_slots: int,
) -> list[ScanPart]:
    """Return a proved sequence as payloads of SEQUENCE, in parts where the board has no room for
    all of it.

    Slots whose currents are just what the board makes of kernels that it keeps (``image``) become
    lists of these; others are written as currents, or as states for a board with one source
    (``switched``). ``measure`` requests voltages.
    """
    slots = len(sequence.width_us)
    given = measure, switched, image
    if slots <= most_slots:
        payload = _payload(sequence, times, *given)
        if len(payload) <= most_bytes:
            return [ScanPart(payload, 0, slots, 0)]
        if not slots:
            raise _too_large(len(payload), most_bytes)
    if times > 1 or not most_slots:
        raise BoardError(
            f"{slots} slots are more than this board takes at once ({most_slots} slots, "
            f"{most_bytes} bytes), and what is sent in parts is not repeated by the board: send it "
            "once each period"
        )
    lists = None if switched or image is None else _kept(sequence, image)
    lengths_us = sequence.width_us.astype(np.int64) + sequence.discharge_us
    size = min(slots, most_slots)
    while True:
        parts = []
        for first in range(0, slots, size):
            end = min(first + size, slots)
            flags = GOES_ON * (first > 0) | MORE * (end < slots)
            part = _cut(sequence, first, end, None if lists is None else lists[0])
            payload = _payload(part, 1, *given, flags)
            if size == 1 and len(payload) > most_bytes:
                # Kernels of which one slot has too many.
                payload = _payload(replace(part, sums=None), 1, *given, flags)
            parts.append(ScanPart(payload, first, end - first, int(lengths_us[:first].sum())))
        largest = max(len(part.payload) for part in parts)
        if largest <= most_bytes:
            return parts
        if size == 1:
            raise _too_large(largest, most_bytes)
        size = max(1, min(size - 1, size * most_bytes // largest))


def _cut(sequence: ScanSequence, first: int, end: int, lists: KernelLists | None) -> ScanSequence:
    """Return slots of a sequence, with their checked lists; its recharge phase with the last."""
    rows, last = slice(first, end), end == len(sequence.width_us)
    sums = None
    if lists is not None and sequence.sums is not None:
        pairs = slice(lists.first[first], lists.first[end])
        starts = lists.first[first : end + 1] - lists.first[first]
        table = sequence.sums.table
        sums = KernelLists(table, starts, lists.kernel[pairs], lists.amplitude[pairs])
    return replace(
        sequence,
        current_ua=sequence.current_ua[rows],
        width_us=sequence.width_us[rows],
        discharge_us=sequence.discharge_us[rows],
        site=sequence.site[rows],
        recharge_ua=sequence.recharge_ua if last else None,
        recharge_us=sequence.recharge_us if last else 0,
        sums=sums,
    )


def _too_large(size: int, most_bytes: int) -> BoardError:
    return BoardError(
        f"a sequence of {size} bytes is above the board's limit of {most_bytes}: scan fewer "
        "points at once"
    )


def _payload(
    sequence: ScanSequence,
    times: int,
    measure: bool,
    switched: bool,
    image: KernelImage | None,
    part: int = 0,
) -> bytes:
    """Return the payload of a SEQUENCE of any size; ``part`` has its flags as part of a scan."""
    shapes, table, shape = _shapes(sequence)
    if shapes > _MOST_SHAPES:
        raise BoardError(
            f"{shapes} pulse shapes in one sequence are above the limit of {_MOST_SHAPES}: "
            "choose fewer pulse widths"
        )
    recharge = sequence.recharge_ua
    if switched and recharge is not None:
        raise BoardError(
            "a recharge phase needs a source for each electrode, and this board has one for all: "
            "leave it out"
        )
    intensity = -(-parts_per_billion(sequence.intensity) * FULL // PPB)
    flags = part | MEASURE * measure | RECHARGE * (recharge is not None)
    # Bytes and arrays, copied only when they are joined.
    parts: list[Any] = [_HEAD.pack(sequence.period_us, times, intensity, flags, shapes), table]
    if recharge is not None:
        parts += [sequence.recharge_us.to_bytes(2, "little"), recharge.astype("<i2").tobytes()]
    if len(sequence.width_us):
        parts += _groups(sequence, shape, switched, image)
    return b"".join(parts)


def _shapes(sequence: ScanSequence) -> tuple[int, bytes, NDArray[np.intp] | None]:
    """Return the number of pulse shapes, all of them, and that of each slot; None if of one."""
    times_us = sequence.width_us.astype(np.uint32) << 16 | sequence.discharge_us
    shapes, shape = times_us[:1], None
    if (times_us != shapes).any():
        shapes, shape = np.unique(times_us, return_inverse=True)
    return len(shapes), (shapes >> 16 | shapes << 16).astype("<u4").tobytes(), shape


def _groups(
    sequence: ScanSequence,
    shape: NDArray[np.intp] | None,
    switched: bool,
    image: KernelImage | None,
) -> list[Any]:
    """Return the groups of slots that have a kind and a shape in common, as bytes and arrays."""
    slots, usual = len(sequence.width_us), STATES if switched else CURRENTS
    kept = None if switched or image is None else _kept(sequence, image)
    if kept is None and shape is None:
        if slots > _U16_MAX:
            raise _too_many(slots)
        return [_GROUP.pack(usual, 0, slots), _rows(sequence, switched)]
    kinds, first, pairs = [usual] * slots, list[int](), b""
    if kept is not None:
        sums, listed = kept
        pairs = np.array([sums.kernel, sums.amplitude], "<u2").T.tobytes()
        first = sums.first.tolist()
        kinds = [
            (POINTS if end - start == 1 else SUM) if by_list else usual
            for start, end, by_list in zip(first, first[1:], listed.tolist(), strict=False)
        ]
    rows = _rows(sequence, switched) if usual in kinds else None
    shapes = [0] * slots if shape is None else shape.tolist()
    parts: list[Any] = []
    end = 0
    while end < slots:
        start, what, own = end, kinds[end], shapes[end]
        end += 1
        # Each sum stands alone.
        while what != SUM and end < slots and (kinds[end], shapes[end]) == (what, own):
            end += 1
        body: Any
        if rows is not None and what >= CURRENTS:
            count, body = end - start, rows[start:end]
        else:
            count, body = first[end] - first[start], pairs[4 * first[start] : 4 * first[end]]
        if count > _U16_MAX:
            raise _too_many(count)
        parts += [_GROUP.pack(what, own, count), body]
    return parts


def _kept(
    sequence: ScanSequence, image: KernelImage
) -> tuple[KernelLists, NDArray[np.bool_]] | None:
    """Return lists of kernels, and of which slots the board makes just the proved currents."""
    sums = sequence.sums
    if sums is None or sums.table is not image.table:
        return None
    # Copies: nothing may change between the check and the write.
    own = KernelLists(image.own, *map(np.array, (sums.first, sums.kernel, sums.amplitude)))
    if not _is_sound(own, sequence.slots):
        return None
    made_ua = own.current_ua()
    same = own.site == sequence.site
    if made_ua.tobytes() != sequence.current_ua.tobytes():
        same &= (made_ua == sequence.current_ua).all(axis=1)
    if own.kernel.max() >= image.count:
        same &= np.maximum.reduceat(own.kernel, own.first[:-1]) < image.count
    # At most what the board adds up in 32 bits.
    if own.amplitude.sum(dtype=np.int64) > _U16_MAX:
        same &= np.add.reduceat(own.amplitude, own.first[:-1], dtype=np.int64) <= _U16_MAX
    return own, same


def _is_sound(lists: KernelLists, slots: int) -> bool:
    """Return whether lists have types and sizes that fit the wire; others would wrap around."""
    first, kernel, amplitude = lists.first, lists.kernel, lists.amplitude
    return bool(
        first.dtype == np.intp
        and kernel.dtype == amplitude.dtype == np.uint16
        and len(first) == slots + 1
        and (first[0], first[-1], len(amplitude)) == (0, len(kernel), len(kernel))
        and (np.diff(first) > 0).all()
        and kernel.max() < len(lists.table.weights)
    )


def _rows(sequence: ScanSequence, switched: bool) -> NDArray[np.int16] | NDArray[np.uint8]:
    """Return each slot's site and currents, or site, source and states, a row each."""
    current_ua = sequence.current_ua
    slots, electrodes = current_ua.shape
    if not switched:
        rows = np.empty((slots, 1 + electrodes), _I16)
        rows[:, 0] = sequence.site
        rows[:, 1:] = current_ua
        return rows
    states = np.frombuffer(pack_states(np.sign(current_ua)), np.uint8)
    columns = [
        sequence.site[:, None].astype("<u2").view(np.uint8),
        source_of(current_ua)[:, None].view(np.uint8),
        states.reshape(slots, -(-electrodes // 4)),
    ]
    return np.concatenate(columns, axis=1)


def _too_many(count: int) -> BoardError:
    return BoardError(
        f"{count} slots or points of one kind are above the limit of {_U16_MAX}: scan fewer points"
    )
