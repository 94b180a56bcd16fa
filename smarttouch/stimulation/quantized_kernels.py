"""Kernels in whole numbers, and as the bytes that boards keep: see ``docs/reference/link.md``."""

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

PEAK = 32_767  # largest magnitude of a kernel's weights
_ROWS = 256  # quantized at once
_HEAD = struct.Struct("<HH")
_SHORTEST_GAP = 3  # zeros from which a new run is shorter than to write them out


def quantized(kernels: NDArray[np.float64]) -> NDArray[np.int16]:
    """Return kernels (K, E) as whole numbers, each row with sum zero; zero stays zero."""
    whole = np.empty(kernels.shape, np.int16)
    for first in range(0, len(kernels), _ROWS):
        whole[first : first + _ROWS] = _quantized(kernels[first : first + _ROWS])
    return whole


def _quantized(kernels: NDArray[np.float64]) -> NDArray[np.float64]:
    peak = np.abs(kernels).max(axis=1, keepdims=True, initial=0)
    carried = np.cumsum(kernels * (PEAK / np.where(peak > 0, peak, 1)), axis=1)
    carried[:, -1:] = 0
    # Halves upward: to even, the peak of (-0.5, 1, -0.5) would be 32,768. Sums of doubles are
    # exact to far less than the sixth decimal.
    whole = np.floor(carried.round(6) + 0.5)
    return np.diff(whole, axis=1, prepend=0)


def kept_kernels(
    weights: NDArray[np.int16], sites: NDArray[np.uint16], room: float, most: int
) -> tuple[bytes, int]:
    """Return kernels (K, E) and their sites (K,) as the bytes that a board keeps, and how many of
    them there is room for, in bytes and in number."""
    parts, size = [b""], _HEAD.size
    for record in _records(weights[:most], sites):
        if size + len(record) > room:
            break
        parts.append(record)
        size += len(record)
    parts[0] = _HEAD.pack(weights.shape[1], len(parts) - 1)
    return b"".join(parts), len(parts) - 1


def _records(weights: NDArray[np.int16], sites: NDArray[np.uint16]) -> Iterator[bytes]:
    """Yield each kernel as runs of weights; long gaps of zeros are left out."""
    for own, site in zip(weights, sites.tolist(), strict=False):
        active = np.flatnonzero(own)
        if not len(active):
            yield _HEAD.pack(site, 0)
            continue
        breaks = np.flatnonzero(np.diff(active) > _SHORTEST_GAP)
        starts = active[np.concatenate([[0], breaks + 1])].tolist()
        ends = (active[np.concatenate([breaks, [len(active) - 1]])] + 1).tolist()
        parts = [_HEAD.pack(site, len(starts))]
        for start, end in zip(starts, ends, strict=True):
            parts += [_HEAD.pack(start, end - start), own[start:end].astype("<i2").tobytes()]
        yield b"".join(parts)
