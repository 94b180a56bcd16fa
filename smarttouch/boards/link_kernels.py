"""Kernels as a ``link`` board keeps them: see ``docs/reference/link.md``."""

import hashlib
import struct
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link_protocol import IDENTITY_BYTES
from smarttouch.stimulation.kernel_table import KernelTable

_HEAD = struct.Struct("<HH")
_RUN = struct.Struct("<HH")
_SHORTEST_GAP = 3  # zeros from which a new run is shorter than to write them out


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
        flat = np.frombuffer(table.weights.tobytes(), np.int16)
        site_of = np.frombuffer(table.site.tobytes(), np.uint16)
        own = KernelTable(flat.reshape(table.weights.shape), site_of, {}, {})
        parts, size = [b""], _HEAD.size
        for weights, site in zip(own.weights[:most], own.site, strict=False):
            record = _record(weights, int(site))
            if size + len(record) > room:
                break
            parts.append(record)
            size += len(record)
        count = len(parts) - 1
        parts[0] = _HEAD.pack(own.weights.shape[1], count)
        data = b"".join(parts)
        return cls(table, own, count, data, digest_of(data))

    def proof(self, session: int) -> bytes:
        """Return what a board that keeps just these kernels answers in a session."""
        return digest_of(session.to_bytes(8, "little") + self.data)


def digest_of(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()[:IDENTITY_BYTES]


def _record(weights: NDArray[np.int16], site: int) -> bytes:
    """Return a kernel as runs of weights; long gaps of zeros are left out."""
    active = np.flatnonzero(weights)
    if not len(active):
        return _RUN.pack(site, 0)
    breaks = np.flatnonzero(np.diff(active) > _SHORTEST_GAP)
    starts = active[np.concatenate([[0], breaks + 1])].tolist()
    ends = (active[np.concatenate([breaks, [len(active) - 1]])] + 1).tolist()
    parts = [_RUN.pack(site, len(starts))]
    for start, end in zip(starts, ends, strict=True):
        parts += [_RUN.pack(start, end - start), weights[start:end].astype("<i2").tobytes()]
    return b"".join(parts)
