"""Drives of afferents under current patterns, fast for patterns that come again.

A point's slot is its kernel times an amplitude, so a pattern seen before, scaled, is looked up:
drives are linear in the currents. The lookup is exact where an afferent may fire. It keeps
every node that may then have the largest drive, and multiplies those with the actual currents.
Which nodes these are is found out when a pattern comes again, as most new ones never do.
"""

from collections.abc import Iterator
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
    """Drives (A,) under a pattern, and the node rows (M, E) of the afferents that may fire.

    Rows of afferent ``fires[i]`` begin at ``starts[i]``.
    """

    drive: Floats
    fires: Indices
    starts: Indices
    rows: Floats


class DriveMemory:
    """Largest drive of each afferent under any currents.

    Rows (N, E), 1/mA, are drives of nodes; `starts`, (A,), is the first node of each afferent.
    Drives from `exact_from` on are exact but for float32; smaller ones may be off by 0.01.
    """

    def __init__(self, rows: Floats, starts: Indices, exact_from: float) -> None:
        self._rows, self._starts = rows, starts
        # A pattern is known from up to twice the amplitude, and from a fiftieth less.
        self._kept_from = exact_from / _MOST - _ALIKE
        self._owner = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        cuts = np.searchsorted(starts, np.arange(0, len(rows), _ROWS_AT_ONCE))
        parts = pairwise(np.unique(np.r_[cuts, len(starts)]).tolist())
        ends = [*starts.tolist(), len(rows)]
        # Runs of afferents, with their nodes, and where each begins among these.
        self._parts = [(a, b, slice(ends[a], ends[b]), starts[a:b] - ends[a]) for a, b in parts]
        self._steepest = np.zeros((len(starts), rows.shape[1]), np.float32)
        for first, last, here, begins in self._parts:
            self._steepest[first:last] = np.maximum.reduceat(np.abs(rows[here]), begins)
        self._patterns = np.zeros((_PATTERNS, rows.shape[1]), np.float32)
        self._square = np.full(_PATTERNS, np.inf, np.float32)
        self._known: list[_Known | None] = [None] * _PATTERNS
        self._next = 0

    def drive(self, current_ma: Floats) -> Floats:
        """Return the largest drive of each afferent, (A, S), for currents (S, E) in mA."""
        highest = np.empty((len(self._starts), len(current_ma)), np.float32)
        which, scale = self._find(current_ma)
        again = np.unique(which[which >= 0])
        self._learn(np.array([each for each in again if self._known[each] is None], np.intp))
        for slot in np.flatnonzero(which >= 0):
            known = self._known[which[slot]]
            assert known is not None
            highest[:, slot] = scale[slot] * known.drive
            if len(known.fires):
                exact = np.maximum.reduceat(known.rows @ current_ma[slot], known.starts)
                highest[known.fires, slot] = exact
        new = np.flatnonzero(which < 0)
        if len(new):
            found = np.empty((len(self._starts), len(new)), np.float32)
            for first, last, _, _, most in self._drives(current_ma[new]):
                found[first:last] = most
            highest[:, new] = found
            self._remember(current_ma[new][-_PATTERNS:])
        return highest

    def _remember(self, current_ma: Floats) -> None:
        """Store new patterns in place of the oldest."""
        places = (self._next + np.arange(len(current_ma))) % _PATTERNS
        self._next = (self._next + len(current_ma)) % _PATTERNS
        self._patterns[places] = current_ma
        square = (current_ma * current_ma).sum(axis=1)
        self._square[places] = np.where(square > 0, square, np.inf)
        for each in places:
            self._known[each] = None

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

    def _learn(self, places: Indices) -> None:
        """Compute the drives under patterns at all nodes."""
        if not len(places):
            return
        highest = np.empty((len(self._starts), len(places)), np.float32)
        nodes, slots = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
        for first, last, begin, drive, most in self._drives(self._patterns[places]):
            highest[first:last] = most
            high = np.flatnonzero(drive >= self._kept_from)
            node, slot = np.divmod(high, len(places))
            alike = drive.ravel()[high] >= highest[self._owner[begin + node], slot] - _ALIKE
            nodes.append(begin + node[alike])
            slots.append(slot[alike])
        node, slot = np.concatenate(nodes), np.concatenate(slots)
        for each, place in enumerate(places):
            mine = node[slot == each]
            fires, starts = np.unique(self._owner[mine], return_index=True)
            drive = highest[:, each].copy()
            self._known[place] = _Known(drive, fires, starts, self._rows[mine])

    def _drives(self, current_ma: Floats) -> Iterator[tuple[int, int, int, Floats, Floats]]:
        """Yield runs of afferents, first and after the last, with the first of their nodes.

        With them come the drives of these nodes, (N, S), and each afferent's largest, (A, S).
        """
        columns = np.ascontiguousarray(current_ma.T)
        for first, last, here, begins in self._parts:
            drive = self._rows[here] @ columns
            yield first, last, here.start, drive, np.maximum.reduceat(drive, begins)
