"""Drives of afferents under current patterns, fast for patterns that come again.

A point's slot is its kernel times an amplitude, so a pattern seen before, scaled, is looked up:
drives are linear in the currents. The lookup is exact where an afferent may fire. It keeps
every node that may then have the largest drive, and multiplies those with the actual currents.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Indices = NDArray[np.intp]

_TOLERANCE = 0.01
"""Largest effect on any drive of currents that are not in proportion: whole microamperes."""
_FEWEST, _MOST = 0.5, 1.02
"""Amplitudes, of that at which a pattern was seen first, at which it is looked up."""
_ALIKE = 2 * _TOLERANCE / _FEWEST
"""Nodes whose drives differ by less may change places."""
_PATTERNS = 256
_ROWS_AT_ONCE = 8192


@dataclass(frozen=True, eq=False)
class _Known:
    """Answer to a pattern: all drives (A,), and the nodes of the afferents that may fire.

    Node rows are (M, E); those of afferent ``fires[i]`` begin at ``starts[i]``.
    """

    drive: Floats
    fires: Indices
    starts: Indices
    rows: Floats


class DriveMemory:
    """Largest drive of each afferent under any currents.

    Parameters
    ----------
    rows : ndarray, (N, E), 1/mA
        Drive of each node for 1 mA at each electrode.
    starts : ndarray, (A,)
        First node of each afferent.
    exact_from : float
        Drive from which answers are exact but for rounding in float32; smaller ones may be off
        by 0.01.
    """

    def __init__(self, rows: Floats, starts: Indices, exact_from: float) -> None:
        self._rows, self._starts = rows, starts
        # A pattern is known from up to twice the amplitude, and from a fiftieth less.
        self._kept_from = exact_from / _MOST - _ALIKE
        self._owner = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        cuts = np.searchsorted(starts, np.arange(0, len(rows), _ROWS_AT_ONCE))
        self._cuts = np.unique(np.r_[cuts, len(starts)])
        self._steepest = np.zeros((len(starts), rows.shape[1]), np.float32)
        for first, last, here in self._parts():
            found = np.maximum.reduceat(np.abs(rows[here]), starts[first:last] - here.start)
            self._steepest[first:last] = found
        self._patterns = np.zeros((_PATTERNS, rows.shape[1]), np.float32)
        self._square = np.full(_PATTERNS, np.inf, np.float32)
        self._known: list[_Known | None] = [None] * _PATTERNS
        self._next = 0

    def drive(self, current_ma: Floats) -> Floats:
        """Return the largest drive of each afferent, (A, S), for currents (S, E) in mA."""
        highest = np.empty((len(self._starts), len(current_ma)), np.float32)
        which, scale = self._find(current_ma)
        for slot in np.flatnonzero(which >= 0):
            known = self._known[which[slot]]
            assert known is not None
            highest[:, slot] = scale[slot] * known.drive
            if len(known.fires):
                exact = np.maximum.reduceat(known.rows @ current_ma[slot], known.starts)
                highest[known.fires, slot] = exact
        new = np.flatnonzero(which < 0)
        if len(new):
            highest[:, new] = self._learn(current_ma[new])
        return highest

    def _find(self, current_ma: Floats) -> tuple[Indices, Floats]:
        """Return the known pattern of each slot, -1 if there is none, and its amplitude."""
        along = current_ma @ self._patterns.T
        scale = along / self._square
        close = np.where((scale >= _FEWEST) & (scale <= _MOST), along * scale, -1.0)
        which = np.asarray(close.argmax(axis=1), np.intp)
        slots = np.arange(len(which))
        scale = scale[slots, which]
        rest = np.abs(current_ma - scale[:, None] * self._patterns[which])
        off = (self._steepest @ rest.T).max(axis=0, initial=0)
        which[(close[slots, which] < 0) | (off > _TOLERANCE)] = -1
        return which, scale

    def _learn(self, current_ma: Floats) -> Floats:
        """Return the drives of patterns from all nodes, and remember them."""
        columns = np.ascontiguousarray(current_ma.T)
        highest = np.empty((len(self._starts), len(current_ma)), np.float32)
        nodes, slots = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
        for first, last, here in self._parts():
            drive = self._rows[here] @ columns
            starts = self._starts[first:last] - here.start
            highest[first:last] = np.maximum.reduceat(drive, starts)
            high = np.flatnonzero(drive >= self._kept_from)
            node, slot = np.divmod(high, len(current_ma))
            node += here.start
            alike = drive.ravel()[high] >= highest[self._owner[node], slot] - _ALIKE
            nodes.append(node[alike])
            slots.append(slot[alike])
        node, slot = np.concatenate(nodes), np.concatenate(slots)
        for each in range(len(current_ma))[-_PATTERNS:]:
            mine, pattern = node[slot == each], current_ma[each]
            fires, starts = np.unique(self._owner[mine], return_index=True)
            self._known[self._next] = _Known(
                highest[:, each].copy(), fires, starts, self._rows[mine]
            )
            self._patterns[self._next] = pattern
            self._square[self._next] = pattern @ pattern or np.inf
            self._next = (self._next + 1) % _PATTERNS
        return highest

    def _parts(self) -> list[tuple[int, int, slice]]:
        """Return runs of afferents, with their nodes, that fit a processor's cache."""
        ends = [*self._starts.tolist(), len(self._rows)]
        return [(a, b, slice(ends[a], ends[b])) for a, b in pairwise(self._cuts.tolist())]
