"""Encoding of kernels, sequences and limits for ``link``, see ``firmware/PROTOCOL.md``."""

import itertools
import math
import struct
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards import link as protocol
from smarttouch.boards.link import CURRENTS, FULL, POINTS, STATES, SUM
from smarttouch.boards.reports import Capabilities
from smarttouch.stimulation.safety_limits import PPB, SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import (
    KernelLists,
    KernelTable,
    ScanSequence,
    kept_kernels,
)

OVERHEAD = protocol.WHOLE_HEAD_BYTES + 4  # bytes of a packet in addition to its payload
_MOST_SHAPES, _U16_MAX = 0xFF, 0xFFFF
_SHAPE = struct.Struct("<HH")  # width and discharge, µs
_OF_LISTS = [np.dtype(np.intp), np.dtype(np.uint16), np.dtype(np.uint16)]


@dataclass(frozen=True, eq=False)
class KernelImage:
    """Kernels of a run, encoded for a board."""

    table: KernelTable
    count: int  # number of kernels that fit on the board, from the start of the table
    data: bytes
    identity: bytes

    @classmethod
    def of(cls, table: KernelTable, room: int, most: int) -> Self:
        """Encode the first kernels of a table, at most ``most`` kernels and ``room`` bytes."""
        data, count = kept_kernels(table.weights, table.site, room, most)
        return cls(table, count, data, protocol.digest_of(data))


def encode_limits(limits: SafetyLimits) -> bytes:
    """Return the payload of LIMITS, with fractions rounded up."""
    part, duty_whole = limits.duty_ratio
    head = protocol.LIMITS.pack(
        limits.period_us, limits.total_ua, limits.pulse_whole_us, math.ceil(limits.full_ua),
        math.ceil(limits.rounding_ua), 0,
        math.ceil(limits.ramp_ns / 1e6), min(_U16_MAX, math.ceil(limits.session_s)),
        math.ceil(1000 * limits.session_mc), math.ceil(100 * part / duty_whole),
        0, limits.width_whole_us,
    )  # fmt: skip
    columns = (limits.current_ua, "<u2"), (limits.felt_ua, "<u2"), (limits.charge_pc, "<u4")
    return head + b"".join(values.astype(kind).tobytes() for values, kind in columns)


class ScanPart(NamedTuple):
    """Part of a scan for one packet, or the complete scan if it fits."""

    payload: bytes
    first: int  # first slot of the part
    slots: int


def encode_scan(
    sequence: ScanSequence, times: int, can: Capabilities, image: KernelImage | None
) -> list[ScanPart]:
    """Encode a proved sequence as payloads of SEQUENCE, in parts if necessary.

    A slot is encoded as a list of kernels if the kernels stored on the board (``image``) add up to
    exactly its currents. Other slots are encoded as currents, or as states for boards with one
    source. Voltages are requested if the board measures them.
    """
    parts: list[ScanPart] = []
    most_bytes, most_slots = (can.packet_bytes or LARGEST_PACKET) - OVERHEAD, can.max_slots
    columns = _columns(sequence, can.output != "weighted", image)
    waiting = [(0, len(sequence.site))]
    while waiting:
        start, end = waiting.pop()
        payload = _payload(sequence, columns, start, end, times, can.measures)
        if len(payload) <= most_bytes and end - start <= most_slots:
            parts.append(ScanPart(payload, start, end - start))
        elif end - start > 1 and times == 1:
            middle = (start + end) // 2
            waiting += [(middle, end), (start, middle)]
        elif image is not None:
            # A slot may have too many kernels for one packet: send currents instead.
            return encode_scan(sequence, times, can, None)
        elif end - start > 1:
            raise BoardError(
                f"{end} slots are more than this board accepts at once ({most_slots} slots, "
                f"{most_bytes} bytes). A board cannot repeat a scan that is sent in parts: send "
                "the sequence once per period, with times=1"
            )
        else:
            raise BoardError(
                f"a sequence of {len(payload)} bytes is above the board's limit of {most_bytes}: "
                "scan fewer points at once"
            )
    return parts


class _Columns(NamedTuple):
    """Slots of a sequence in encoded form, before they are split into parts."""

    shapes: bytes  # table of pulse shapes
    keys: list[tuple[int, int]]  # for each slot, its kind and the index of its shape in `shapes`
    first: list[int]  # per slot, index of its first pair in ``pairs``; last item: number of pairs
    pairs: bytes  # pairs of kernel and amplitude
    rows: bytes  # site and currents of each slot; for boards with one source, see `_switched_rows`


def _columns(sequence: ScanSequence, switched: bool, image: KernelImage | None) -> _Columns:
    times_us = [*zip(sequence.width_us.tolist(), sequence.discharge_us.tolist(), strict=True)]
    shapes = sorted(set(times_us))
    if len(shapes) > _MOST_SHAPES:
        raise BoardError(
            f"{len(shapes)} pulse shapes in one sequence are above the limit of {_MOST_SHAPES}: "
            "choose fewer pulse widths"
        )
    lists, first, pairs, rows = sequence.sums, [0], b"", b""
    kinds = [STATES if switched else CURRENTS] * len(times_us)
    if (
        image is not None and not switched and times_us and isinstance(lists, KernelLists)
        and lists.table is image.table
        # Arrays of other types or sizes could overflow on the wire.
        and [lists.first.dtype, lists.kernel.dtype, lists.amplitude.dtype] == _OF_LISTS
        and (len(lists.first), lists.first[0]) == (len(times_us) + 1, 0)
        and len(lists.kernel) == len(lists.amplitude) == lists.first[-1]
    ):  # fmt: skip
        first, kernel = lists.first.tolist(), lists.kernel.tolist()
        amplitude = lists.amplitude.tolist()
        pairs = np.array([lists.kernel, lists.amplitude], "<u2").T.tobytes()
        same = (lists.site == sequence.site) & (lists.current_ua == sequence.current_ua).all(axis=1)
        for slot, (at, until) in enumerate(itertools.pairwise(first)):
            # Send kernel lists only if the 32-bit sums of the board equal the proved currents.
            whole = until > at and max(kernel[at:until]) < image.count and until - at <= FULL
            if same[slot] and whole and sum(amplitude[at:until]) <= FULL:
                kinds[slot] = POINTS if until - at == 1 else SUM
    if max(kinds, default=SUM) > SUM:
        site, current_ua = sequence.site[:, None].astype("<u2"), sequence.current_ua
        if switched:
            rows = _switched_rows(site, current_ua)
        else:
            rows = np.concatenate([site.view("<i2"), current_ua], axis=1, dtype="<i2").tobytes()
    keys = [*zip(kinds, map(shapes.index, times_us), strict=True)]
    return _Columns(b"".join(itertools.starmap(_SHAPE.pack, shapes)), keys, first, pairs, rows)


def _switched_rows(site: NDArray[np.uint16], current_ua: NDArray[np.int16]) -> bytes:
    """Encode each slot as site, current of the source, and states of all electrodes."""
    # The gate allows only currents that fit 16 bits.
    source_ua = np.maximum(current_ua, 0).sum(axis=1)
    bits = np.stack([current_ua > 0, current_ua < 0], axis=-1).reshape(len(site), -1)
    states = np.packbits(bits, axis=1, bitorder="little")
    source = source_ua.astype("<u2")[:, None]
    return np.concatenate([site.view(np.uint8), source.view(np.uint8), states], axis=1).tobytes()


def _payload(
    sequence: ScanSequence, columns: _Columns, start: int, end: int, times: int, measure: bool
) -> bytes:
    """Encode slots ``start`` to ``end`` - 1. After the last slot, add the recharge phase."""
    shapes, keys, first, pairs, rows = columns
    flags = protocol.GOES_ON * (start > 0) | protocol.MORE * (end < len(keys))
    flags |= protocol.MEASURE * measure
    tail = b""
    if sequence.recharge_ua is not None and end == len(keys):
        flags |= protocol.RECHARGE
        tail = sequence.recharge_us.to_bytes(2, "little")
        tail += sequence.recharge_ua.astype("<i2").tobytes()
    intensity = -(-parts_per_billion(sequence.intensity) * FULL // PPB)
    head = protocol.SEQUENCE.pack(sequence.period_us, times, intensity, flags, len(shapes) // 4)
    data, size, at = [head, shapes, tail], len(rows) // max(1, len(keys)), start
    for slot in range(start + 1, end + 1):
        kind, shape = keys[at]
        # Slots of the same kind and shape share a group. Each SUM needs its own group.
        if kind != SUM and slot < end and keys[slot] == keys[at]:
            continue
        count, body = slot - at, rows[at * size : slot * size]
        if kind < CURRENTS:
            count, body = first[slot] - first[at], pairs[4 * first[at] : 4 * first[slot]]
        data += protocol.GROUP.pack(kind, shape, count), body
        at = slot
    return b"".join(data)
