"""Kernels, sequences and limits as payloads of ``link``: see ``firmware/PROTOCOL.md``."""

import itertools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.boards.link.protocol import (
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
    part, whole = limits.duty_ratio
    head = LIMITS.pack(
        limits.period_us, limits.total_ua, limits.pulse_whole_us, math.ceil(limits.full_ua),
        math.ceil(limits.rounding_ua), 0,
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
    slots, recharge = sequence.slots, sequence.recharge_ua
    if switched and recharge is not None:
        raise BoardError(
            "a recharge phase needs a source for each electrode, and this board has one for all: "
            "leave it out"
        )
    groups = _Groups(sequence, switched, image)
    intensity = -(-parts_per_billion(sequence.intensity) * FULL // PPB)
    whole: list[ScanPart] = []
    ends = [slots]  # of the parts to come, the next one last
    start = 0
    while not whole or start < slots:
        end = ends[-1]
        flags = GOES_ON * (start > 0) | MORE * (end < slots) | MEASURE * measure
        parts = [b"", groups.table]
        if recharge is not None and end == slots:
            flags |= RECHARGE
            parts += [sequence.recharge_us.to_bytes(2, "little"), recharge.astype("<i2").tobytes()]
        head = (sequence.period_us, times, intensity, flags, groups.shapes)
        parts[0] = SEQUENCE.pack(*head)
        payload = b"".join(parts + groups.between(start, end))
        if len(payload) <= most_bytes and end - start <= most_slots:
            whole.append(ScanPart(payload, start, end - start))
            start = ends.pop()
        elif times > 1 and end - start > 1:
            raise BoardError(
                f"{slots} slots are more than this board takes at once ({most_slots} slots, "
                f"{most_bytes} bytes), and what is sent in parts is not repeated by the board: "
                "send it once each period"
            )
        elif end - start > 1:
            ends.append((start + end) // 2)
        elif image is not None:
            # One slot has too many kernels.
            return encode_scan(sequence, times, measure, switched, None, most_bytes, most_slots)
        else:
            raise BoardError(
                f"a sequence of {len(payload)} bytes is above the board's limit of {most_bytes}: "
                "scan fewer points at once"
            )
    return whole


class _Groups:
    """Slots of a sequence as groups that have a kind and a shape in common."""

    def __init__(self, sequence: ScanSequence, switched: bool, image: KernelImage | None) -> None:
        times_us = sequence.width_us.astype(np.uint32) << 16 | sequence.discharge_us
        shapes = times_us[:1]
        self._shape: NDArray[np.integer[Any]] = np.zeros(len(times_us), np.intp)
        if (times_us != shapes).any():
            shapes, self._shape = np.unique(times_us, return_inverse=True)
        self.shapes: int = len(shapes)
        if self.shapes > _MOST_SHAPES:
            raise BoardError(
                f"{self.shapes} pulse shapes in one sequence are above the limit of "
                f"{_MOST_SHAPES}: choose fewer pulse widths"
            )
        self.table: bytes = (shapes >> 16 | shapes << 16).astype("<u4").tobytes()
        self._usual = STATES if switched else CURRENTS
        self._kind = np.full(sequence.slots, self._usual)
        lists = None if switched or image is None else sequence.sums
        if isinstance(lists, KernelLists) and image is not None and lists.table is image.table:
            self._list(sequence, lists, image)
        if (self._kind == self._usual).any():
            self._rows = _rows(sequence, switched)
        # Each sum stands alone.
        kind = self._kind
        self._cuts = (np.diff(kind) != 0) | (np.diff(self._shape) != 0) | (kind[1:] == SUM)

    def _list(self, sequence: ScanSequence, lists: KernelLists, image: KernelImage) -> None:
        """Make lists of the slots of which a board makes just the proved currents."""
        first, kernel, amplitude, slots = lists.first, lists.kernel, lists.amplitude, sequence.slots
        # Other types and sizes would wrap around on the wire.
        if (
            not slots
            or first.dtype != np.intp
            or kernel.dtype != np.uint16
            or amplitude.dtype != np.uint16
            or (len(first), first[0], first[-1]) != (slots + 1, 0, len(kernel))
            or len(kernel) != len(amplitude)
            or (counts := np.diff(first)).min() < 1
            or kernel.max() >= len(lists.table.weights)
        ):
            return
        same = (lists.site == sequence.site) & (lists.current_ua == sequence.current_ua).all(axis=1)
        same &= np.maximum.reduceat(kernel, first[:-1]) < image.count
        # At most what the board adds up in 32 bits.
        same &= np.add.reduceat(amplitude, first[:-1], dtype=np.int64) <= FULL
        self._first, self._pairs = first, np.array([kernel, amplitude], "<u2").T
        self._kind[same] = np.where(counts == 1, POINTS, SUM)[same]

    def between(self, start: int, end: int) -> list[Any]:
        """Return the groups of some slots, as bytes and arrays."""
        if start == end:
            return []
        starts = [start, *(np.flatnonzero(self._cuts[start : end - 1]) + start + 1).tolist(), end]
        parts: list[Any] = []
        for at, until in itertools.pairwise(starts):
            kind = self._kind[at]
            if kind == self._usual:
                body = self._rows[at:until]
            else:
                body = self._pairs[self._first[at] : self._first[until]]
            if len(body) > _U16_MAX:
                raise BoardError(
                    f"{len(body)} slots or points of one kind are above the limit of {_U16_MAX}: "
                    "scan fewer points"
                )
            parts += [GROUP.pack(kind, self._shape[at], len(body)), np.ascontiguousarray(body)]
        return parts


def _rows(sequence: ScanSequence, switched: bool) -> NDArray[np.int16] | NDArray[np.uint8]:
    """Return each slot's site and currents, or site, source and states, a row each."""
    site, current_ua = sequence.site[:, None].astype("<u2"), sequence.current_ua
    if not switched:
        return np.concatenate([site.view("<i2"), current_ua.astype("<i2", copy=False)], axis=1)
    source = source_of(current_ua)[:, None].view(np.uint8)
    states = np.frombuffer(pack_states(np.sign(current_ua)), np.uint8)
    columns = [site.view(np.uint8), source, states.reshape(len(site), -(-current_ua.shape[1] // 4))]
    return np.concatenate(columns, axis=1)
