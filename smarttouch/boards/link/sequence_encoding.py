"""Kernels, sequences and limits as payloads of ``link``: see ``firmware/PROTOCOL.md``."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.link import (
    CURRENTS,
    FULL,
    GOES_ON,
    GROUP,
    LIMITS,
    MEASURE,
    MORE,
    POINTS,
    RECHARGE,
    SEQUENCE,
    STATES,
    SUM,
    digest_of,
    pack_states,
    source_of,
)
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import (
    KernelLists,
    KernelTable,
    ScanSequence,
    kept_kernels,
)

_MOST_SHAPES, _U16_MAX = 0xFF, 0xFFFF


@dataclass(frozen=True, eq=False)
class KernelImage:
    """The kernels of a run, as bytes for a board."""

    table: KernelTable
    count: int  # kernels that the board has room for: the first of the table
    data: bytes
    identity: bytes

    @classmethod
    def of(cls, table: KernelTable, room: int, most: int) -> Self:
        """Return as many kernels as there is room for, in bytes and in number."""
        data, count = kept_kernels(table.weights, table.site, room, most)
        return cls(table, count, data, digest_of(data))


def encode_limits(limits: SafetyLimits) -> bytes:
    """Return the payload of LIMITS: nothing in it allows more than the limits do."""
    part, duty_whole = limits.duty_ratio
    head = LIMITS.pack(
        limits.period_us, limits.total_ua, limits.pulse_whole_us, math.ceil(limits.full_ua),
        math.ceil(limits.rounding_ua), 0,
        math.ceil(limits.ramp_ns / 1e6), min(_U16_MAX, math.ceil(limits.session_s)),
        math.ceil(1000 * limits.session_mc), math.ceil(100 * part / duty_whole),
        0, limits.width_whole_us,
    )  # fmt: skip
    columns = (limits.current_ua, "<u2"), (limits.felt_ua, "<u2"), (limits.charge_pc, "<u4")
    return head + b"".join(values.astype(kind).tobytes() for values, kind in columns)


class ScanPart(NamedTuple):
    """Part of a scan, which is all of it where the board has room for that."""

    payload: bytes
    first: int  # slot of the scan with which it begins
    slots: int


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
    recharge = sequence.recharge_ua
    if switched and recharge is not None:
        raise BoardError(
            "a recharge phase needs a source for each electrode, and this board has one for all: "
            "leave it out"
        )
    intensity = -(-parts_per_billion(sequence.intensity) * FULL // PPB)
    shapes, shape = _shapes(sequence)
    kind, first, pairs = _kinds(sequence, switched, image)
    rows = _rows(sequence, switched)
    # Each sum stands alone.
    cuts = (np.diff(kind) != 0) | (np.diff(shape) != 0) | (kind[1:] == SUM)

    def payload(start: int, end: int) -> bytes:
        flags = GOES_ON * (start > 0) | MORE * (end < sequence.slots) | MEASURE * measure
        tail = b""
        if recharge is not None and end == sequence.slots:
            flags |= RECHARGE
            tail = sequence.recharge_us.to_bytes(2, "little") + recharge.astype("<i2").tobytes()
        head = (sequence.period_us, times, intensity, flags, len(shapes) // 4)
        data = [SEQUENCE.pack(*head), shapes, tail]
        starts = [start, *(np.flatnonzero(cuts[start : end - 1]) + start + 1).tolist(), end]
        for at, until in itertools.pairwise(starts if end > start else []):
            body = pairs[first[at] : first[until]] if kind[at] < CURRENTS else rows[at:until]
            if len(body) > _U16_MAX:
                raise BoardError(
                    f"{len(body)} slots or points of one kind are above the limit of {_U16_MAX}: "
                    "scan fewer points"
                )
            data += [GROUP.pack(kind[at], shape[at], len(body)), body.tobytes()]
        return b"".join(data)

    try:
        return _in_parts(payload, 0, sequence.slots, times, most_bytes, most_slots)
    except BoardError:
        if image is None:
            raise
        # One slot may have too many kernels.
        return encode_scan(sequence, times, measure, switched, None, most_bytes, most_slots)


def _in_parts(
    encode: Callable[[int, int], bytes],
    start: int,
    end: int,
    times: int,
    most_bytes: int,
    most_slots: int,
) -> list[ScanPart]:
    """Return slots as one part if there is room for it, else each half of them so."""
    payload, middle = encode(start, end), (start + end) // 2
    if len(payload) <= most_bytes and end - start <= most_slots:
        return [ScanPart(payload, start, end - start)]
    if end - start <= 1:
        raise BoardError(
            f"a sequence of {len(payload)} bytes is above the board's limit of {most_bytes}: "
            "scan fewer points at once"
        )
    if times > 1:
        raise BoardError(
            f"{end} slots are more than this board takes at once ({most_slots} slots, "
            f"{most_bytes} bytes), and what is sent in parts is not repeated by the board: send it "
            "once each period"
        )
    halves = (start, middle), (middle, end)
    return [
        part for half in halves for part in _in_parts(encode, *half, times, most_bytes, most_slots)
    ]


def _shapes(sequence: ScanSequence) -> tuple[bytes, NDArray[np.intp]]:
    """Return the table of a sequence's pulse shapes, and each slot's place in it, (S,)."""
    times_us = sequence.width_us.astype(np.uint32) << 16 | sequence.discharge_us
    shapes, index = times_us[:1], np.zeros(len(times_us), np.intp)
    if (times_us != shapes).any():
        shapes, index = np.unique(times_us, return_inverse=True)
    if len(shapes) > _MOST_SHAPES:
        raise BoardError(
            f"{len(shapes)} pulse shapes in one sequence are above the limit of {_MOST_SHAPES}: "
            "choose fewer pulse widths"
        )
    return (shapes >> 16 | shapes << 16).astype("<u4").tobytes(), index


def _kinds(
    sequence: ScanSequence, switched: bool, image: KernelImage | None
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.uint16]]:
    """Return the kind of each slot, (S,), and the lists of kernels: where each slot's begins, and
    all their kernels and amplitudes. Slots are lists if a board makes just the proved currents of
    them."""
    kind, slots = np.full(sequence.slots, STATES if switched else CURRENTS), sequence.slots
    nothing, lists = (kind, kind, np.zeros((0, 2), np.uint16)), sequence.sums
    if switched or image is None or not slots or not isinstance(lists, KernelLists):
        return nothing
    first, kernel, amplitude = lists.first, lists.kernel, lists.amplitude
    # Other types and sizes would wrap around on the wire.
    if (
        lists.table is not image.table
        or first.dtype != np.intp
        or [kernel.dtype, amplitude.dtype] != [np.dtype(np.uint16)] * 2
        or (len(first), first[0], first[-1]) != (slots + 1, 0, len(kernel))
        or len(kernel) != len(amplitude)
        or (counts := np.diff(first)).min() < 1
        or kernel.max() >= len(lists.table.weights)
    ):
        return nothing
    same = (lists.site == sequence.site) & (lists.current_ua == sequence.current_ua).all(axis=1)
    same &= np.maximum.reduceat(kernel, first[:-1]) < image.count
    # At most what the board adds up in 32 bits.
    same &= np.add.reduceat(amplitude, first[:-1], dtype=np.int64) <= FULL
    kind[same] = np.where(counts == 1, POINTS, SUM)[same]
    return kind, first, np.array([kernel, amplitude], "<u2").T


def _rows(sequence: ScanSequence, switched: bool) -> NDArray[np.int16] | NDArray[np.uint8]:
    """Return each slot's site and currents, or site, source and states, a row each."""
    site, current_ua = sequence.site[:, None].astype("<u2"), sequence.current_ua
    if not switched:
        return np.concatenate([site.view("<i2"), current_ua.astype("<i2", copy=False)], axis=1)
    source = source_of(current_ua)[:, None].view(np.uint8)
    states = np.frombuffer(pack_states(np.sign(current_ua)), np.uint8)
    columns = [site.view(np.uint8), source, states.reshape(len(site), -(-current_ua.shape[1] // 4))]
    return np.concatenate(columns, axis=1)
