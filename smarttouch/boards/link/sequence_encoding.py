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
from smarttouch.stimulation.ramp import PPB
from smarttouch.stimulation.safety_limits import SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import (
    KernelLists,
    KernelTable,
    ScanSequence,
    kept_kernels,
)


@dataclass(frozen=True, eq=False)
class KernelImage:
    """The kernels of a run, as bytes for a board."""

    table: KernelTable
    count: int  # kernels that the board has room for: the first of the table
    data: bytes
    identity: bytes  # first 16 bytes of the SHA-256 of ``data``

    @classmethod
    def of(cls, table: KernelTable, room: int, most: int) -> Self:
        """Return as many kernels as there is room for, in bytes and in number."""
        data, count = kept_kernels(table.weights, table.site, room, most)
        return cls(table, count, data, digest_of(data))

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


_Kept = tuple[KernelLists, NDArray[np.bool_]]
"""Lists of kernels, and of which slots the board makes just the proved currents."""


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
    kept = None if switched or image is None else _kept(sequence, image)
    slots, lengths_us = sequence.slots, sequence.width_us.astype(np.int64) + sequence.discharge_us

    def parts_of(first: int, end: int) -> list[ScanPart]:
        """Return slots as one part, or the parts of each half if the board has no room for all."""
        count, flags = end - first, GOES_ON * (first > 0) | MORE * (end < slots)
        if count <= max(most_slots, 1):
            part = _cut(sequence, first, end) if flags else sequence
            payload = _payload(part, times, measure, switched, _cut_lists(kept, first, end), flags)
            if count == 1 and len(payload) > most_bytes:
                # Kernels of which one slot has too many.
                payload = _payload(part, times, measure, switched, None, flags)
            if len(payload) <= most_bytes and count <= most_slots:
                return [ScanPart(payload, first, count, int(lengths_us[:first].sum()))]
            if count <= 1:
                raise BoardError(
                    f"a sequence of {len(payload)} bytes is above the board's limit of "
                    f"{most_bytes}: scan fewer points at once"
                )
        if times > 1:
            raise BoardError(
                f"{slots} slots are more than this board takes at once ({most_slots} slots, "
                f"{most_bytes} bytes), and what is sent in parts is not repeated by the board: "
                "send it once each period"
            )
        middle = (first + end) // 2
        return [*parts_of(first, middle), *parts_of(middle, end)]

    return parts_of(0, slots)


def _cut(sequence: ScanSequence, first: int, end: int) -> ScanSequence:
    """Return slots of a sequence, without lists; its recharge phase with the last."""
    rows, last = slice(first, end), end == sequence.slots
    return replace(
        sequence,
        current_ua=sequence.current_ua[rows],
        width_us=sequence.width_us[rows],
        discharge_us=sequence.discharge_us[rows],
        site=sequence.site[rows],
        recharge_ua=sequence.recharge_ua if last else None,
        recharge_us=sequence.recharge_us if last else 0,
        sums=None,
    )


def _cut_lists(kept: _Kept | None, first: int, end: int) -> _Kept | None:
    if kept is None:
        return None
    lists, listed = kept
    starts, pairs = lists.first[first : end + 1], slice(lists.first[first], lists.first[end])
    cut = (starts - starts[0], lists.kernel[pairs], lists.amplitude[pairs])
    return KernelLists(lists.table, *cut), listed[first:end]


def _payload(
    sequence: ScanSequence, times: int, measure: bool, switched: bool, kept: _Kept | None, part: int
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
        parts += _groups(sequence, shape, switched, kept)
    return b"".join(parts)


def _shapes(sequence: ScanSequence) -> tuple[int, bytes, NDArray[np.intp]]:
    """Return the number of pulse shapes, all of them, and that of each slot."""
    times_us = sequence.width_us.astype(np.uint32) << 16 | sequence.discharge_us
    shapes, shape = np.unique(times_us, return_inverse=True)
    return len(shapes), (shapes >> 16 | shapes << 16).astype("<u4").tobytes(), shape


def _groups(
    sequence: ScanSequence, shape: NDArray[np.intp], switched: bool, kept: _Kept | None
) -> list[Any]:
    """Return the groups of slots that have a kind and a shape in common, as bytes and arrays."""
    slots, usual = sequence.slots, STATES if switched else CURRENTS
    kind = np.full(slots, usual)
    first, pairs = kind, kind
    if kept is not None:
        lists, listed = kept
        first, pairs = lists.first, np.array([lists.kernel, lists.amplitude], "<u2").T
        kind[listed] = np.where(np.diff(first) == 1, POINTS, SUM)[listed]
    # Each sum stands alone.
    alone = (np.diff(kind) != 0) | (np.diff(shape) != 0) | (kind[1:] == SUM)
    starts = [0, *(np.flatnonzero(alone) + 1).tolist()]
    rows = _rows(sequence, switched) if (kind == usual).any() else pairs
    parts: list[Any] = []
    for start, end in zip(starts, [*starts[1:], slots], strict=True):
        body = rows[start:end] if kind[start] == usual else pairs[first[start] : first[end]]
        if len(body) > _U16_MAX:
            raise BoardError(
                f"{len(body)} slots or points of one kind are above the limit of {_U16_MAX}: scan "
                "fewer points"
            )
        parts += [_GROUP.pack(kind[start], shape[start], len(body)), np.ascontiguousarray(body)]
    return parts


def _kept(sequence: ScanSequence, image: KernelImage) -> _Kept | None:
    """Return lists of kernels, and of which slots the board makes just the proved currents."""
    own = sequence.sums
    if type(own) is not KernelLists or own.table is not image.table:
        return None
    if not sequence.slots or not _is_sound(own, sequence.slots):
        return None
    same = (own.site == sequence.site) & (own.current_ua == sequence.current_ua).all(axis=1)
    same &= np.maximum.reduceat(own.kernel, own.first[:-1]) < image.count
    # At most what the board adds up in 32 bits.
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
