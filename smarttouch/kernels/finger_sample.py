"""Afferents of several fingers, for the design of kernels."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from smarttouch.physiology.finger import Finger

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.intp]

SEEN = 0.3
"""Drive from which the node of an afferent that fires first is looked for."""
_FIRES = 0.9
_ROWS_AT_ONCE = 16_384


@dataclass(frozen=True, eq=False)
class FingerSample:
    """Afferents of several fingers, and those of their nodes that may fire."""

    rows: Floats  # (N, E) 1/mA: drive of each node per mA at each electrode; 1 is the threshold
    starts: Indices  # (A,) first node of each afferent
    classes: NDArray[np.int8]  # (A,)
    finger: Indices  # (A,) number of its finger
    receptor_mm: Floats  # (A, 2)

    @classmethod
    def of(
        cls, fingers: Sequence[Finger], electrode_ma: float = np.inf, total_ma: float = np.inf
    ) -> "FingerSample":
        """Return a sample of fingers, without nodes that no currents within limits can fire."""
        parts = [_within_reach(*each.rows, electrode_ma, total_ma) for each in fingers]
        before = np.cumsum([0, *(len(rows) for rows, _ in parts)])
        return cls(
            np.concatenate([rows for rows, _ in parts]),
            np.concatenate([starts + n for (_, starts), n in zip(parts, before, strict=False)]),
            np.concatenate([each.classes for each in fingers]),
            np.repeat(np.arange(len(fingers)), [len(each.classes) for each in fingers]),
            np.concatenate([each.receptor_mm for each in fingers]),
        )

    @property
    def fingers(self) -> int:
        return int(self.finger[-1]) + 1

    def drives(self, current_ma: Array) -> tuple[Floats, NDArray[np.int32]]:
        """Return afferents' largest drives by currents (S, E) mA and nodes from `SEEN` on, (A,
        S)."""
        columns = np.ascontiguousarray(current_ma.T, np.float32)
        highest = np.empty((len(self.starts), columns.shape[1]), np.float32)
        node = np.full(highest.shape, -1, np.int32)
        ends = np.append(self.starts[1:], len(self.rows))
        cuts = np.searchsorted(self.starts, np.arange(0, len(self.rows), _ROWS_AT_ONCE))
        cuts = np.unique(np.append(cuts, len(self.starts)))
        for first, last in pairwise(cuts.tolist()):
            here = slice(self.starts[first], ends[last - 1])
            drive = self.rows[here] @ columns
            starts = self.starts[first:last] - here.start
            most = np.maximum.reduceat(drive, starts)
            highest[first:last] = most
            owner = np.repeat(np.arange(last - first), np.diff(np.append(starts, len(drive))))
            row, site = np.nonzero(drive >= np.maximum(most, SEEN)[owner])
            node[first + owner[row], site] = here.start + row
        return highest, node


def _within_reach(
    rows: Floats, starts: Indices, electrode_ma: float, total_ma: float
) -> tuple[Floats, Indices]:
    """Return the nodes that balanced currents within limits can fire; each afferent keeps one."""
    if np.isinf(electrode_ma):
        return rows, starts
    ranked = np.sort(rows, axis=1)
    share = np.clip(total_ma - electrode_ma * np.arange(rows.shape[1]), 0, electrode_ma)
    can = np.maximum(ranked[:, ::-1] - ranked, 0) @ share.astype(np.float32) >= _FIRES
    can[starts] = True
    return rows[can], np.cumsum(can)[starts] - 1
