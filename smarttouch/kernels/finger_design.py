"""Kernels designed on simulated fingers, for few unwanted afferents and no silent point.

For the afferents of a sample of fingers, with drives D(w) that are linear in the currents w up to
the choice of a node::

    minimize   Σ wrong·(D − 1 + margin)₊   other classes
             + Σ elsewhere·(D − 1 + margin)₊   own class, receptor beyond a pitch
             + Σ near·(1 + margin − D)₊   own class, receptor within a pitch
             + Σ silent·(1 + margin − max D)₊   each finger, receptors within half a pitch
    such that  Σw = 0,  Σ|w| and |w| within those of the kernel designed on a node

All rows of the first two that are broken are added until none is. What is to fire takes the node
that is nearest to firing, chosen again in each round: the answer is as good as can be for these
nodes. The start is the kernel designed on a node, and no answer is worse on the sample.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.intp]

SEEN = 0.3  # drive from which the node of an afferent that fires first is looked for
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


Progress = Callable[[int, int], None]

_MARGIN = 0.05
_STEPS = (0.25, 0.25, 0.2, 0.2, 0.15, 0.15, 0.1, 0.1)
"""Largest change of an electrode's current in each round, of the full current: what a round does
not know of is not far beyond what it does."""
_CONSIDERED = 0.8  # drive from which the node of an afferent that is not to fire becomes a row
_WRONG, _ELSEWHERE, _NEAR, _SILENT = 1.0, 0.3, 0.3, 30.0
"""Cost of an afferent of another class that fires, of one of the own class that fires beyond a
pitch, of one that does not within it, and of a finger in which none does within half a pitch."""


@dataclass(frozen=True, eq=False)
class Aim:
    """Which afferents the kernel of each site is to fire."""

    # (A, S), own class, receptor within a pitch of where the site is perceived
    near: NDArray[np.bool_]
    nearest: NDArray[np.bool_]  # (A, S), the same within half a pitch
    own: NDArray[np.bool_]  # (A,)

    @classmethod
    def of(cls, profile: Profile, afferent: Afferent, sample: FingerSample) -> "Aim":
        shifts = profile.perception
        shift_mm = (shifts.ra_shift_mm, shifts.sai_shift_mm, shifts.pc_shift_mm)[afferent]
        place_mm = profile.electrodes.position_mm + shift_mm
        away_mm = np.linalg.norm(sample.receptor_mm[:, None] - place_mm, axis=2)
        own = sample.classes == afferent
        pitch_mm = profile.electrodes.pitch_mm
        return cls(
            (away_mm <= pitch_mm) & own[:, None], (away_mm <= pitch_mm / 2) & own[:, None], own
        )


class FingerDesign:
    """Design of the kernels of one class on a sample of fingers.

    The kernels `start_ma`, (E, E) mA at full comfort, bound the currents and start the search.
    Where mirrored fingers are as likely, `mirror`, (E,), gives each electrode's image: kernels are
    then designed on the mirrored sample too, and mirror one another.
    """

    def __init__(
        self,
        profile: Profile,
        afferent: Afferent,
        sample: FingerSample,
        start_ma: Array,
        mirror: Indices | None = None,
    ) -> None:
        self.profile: Profile = profile
        self.afferent: Afferent = afferent
        self.sample: FingerSample = sample
        self.current_ma: NDArray[np.float64] = np.array(start_ma, np.float64)
        self._start_ma = np.asarray(start_ma, np.float64)
        self._driven = np.isin(np.arange(len(start_ma)), profile.driven)
        # Sequences hold whole µA: every electrode keeps room to be rounded up.
        limits = np.array(profile.limits.electrode_ma or np.full(len(start_ma), np.inf))
        self._limit_ma = np.maximum(limits - len(start_ma) / 1000, 0)
        self._aim = Aim.of(profile, afferent, sample)
        self._mirror = np.arange(len(start_ma)) if mirror is None else mirror
        self._pool: dict[int, dict[tuple[int, int], set[int]]] = {}

    def designed(self, sites: Indices, progress: Progress | None = None) -> Array:
        """Return kernels of sites at full comfort, (S, E) mA; DesignError if the solver fails."""
        from joblib import Parallel, delayed

        first = np.unique(np.minimum(sites, self._mirror[sites]))
        both = np.unique(np.concatenate([first, self._mirror[first]]))
        best_ma, least = self.current_ma[both].copy(), np.full(len(both), np.inf)
        steps: tuple[float | None, ...] = (*_STEPS, None)
        for done, step in enumerate(steps):
            highest, node = self.sample.drives(self.current_ma[both])
            loss = self._loss(highest, both)
            # A pair is judged together, and stays one.
            loss += loss[np.searchsorted(both, self._mirror[both])]
            better = loss < least - 1e-9
            least[better], best_ma[better] = loss[better], self.current_ma[both[better]]
            if step is not None:
                work = Parallel(n_jobs=-1, prefer="threads")
                programs = [self._program(site, both, highest, node, step) for site in first]
                for site, found in zip(
                    first, work(delayed(_solved)(each) for each in programs), strict=True
                ):
                    self.current_ma[site] = found
                    self.current_ma[self._mirror[site]] = found[self._mirror]
            if progress is not None:
                progress(done + 1, len(_STEPS) + 1)
        self.current_ma[both] = best_ma
        return np.asarray(self.current_ma[sites])

    def figures(self, sites: Indices) -> tuple[Array, Array, NDArray[np.int8]]:
        """Return selectivity on the sample at each site, (S,): others, spill, and worst class.

        The first is the fraction of firing afferents that are of other classes, the second the
        fraction of firing own ones with receptors beyond a pitch.
        """
        highest, _ = self.sample.drives(self.current_ma[sites])
        fires = highest >= 1
        own = fires & self._aim.own[:, None]
        wrong = 1 - own.sum(axis=0) / np.maximum(fires.sum(axis=0), 1)
        right = (own & self._aim.near[:, sites]).sum(axis=0)
        others = [each for each in Afferent if each is not self.afferent]
        counts = np.array([fires[self.sample.classes == each].sum(axis=0) for each in others])
        worst = np.array(others, np.int8)[counts.argmax(axis=0)]
        return wrong, 1 - right / np.maximum(own.sum(axis=0), 1), worst

    def _loss(self, highest: Floats, sites: Indices) -> Array:
        """Return the cost at each site, summed over the whole sample, (S,)."""
        near, nearest = self._aim.near[:, sites], self._aim.nearest[:, sites]
        price = np.where(self._aim.own, _ELSEWHERE, _WRONG)[:, None]
        over = np.maximum(highest - (1 - _MARGIN), 0) * price
        short = np.clip(1 + _MARGIN - highest, 0, 1 + _MARGIN - SEEN)
        loss = np.where(near, _NEAR * short, over).sum(axis=0)
        for index in range(self.sample.fingers):
            mine = self.sample.finger == index
            there = nearest[mine]
            least = np.where(there, short[mine], np.inf).min(axis=0)
            loss += _SILENT * np.where(there.any(axis=0), least, 0)
        return np.asarray(loss, np.float64)

    def _program(
        self, site: int, both: Indices, highest: Floats, node: NDArray[np.int32], step: float
    ) -> "_Program":
        """Return the linear program of a site, on its own sample and on the mirrored one."""
        rows: list[Floats] = []
        limit: list[float] = []
        slack: list[int] = []
        price: list[float] = []
        pool = self._pool.setdefault(int(site), {})
        for turned, aimed in enumerate((int(site), int(self._mirror[site]))):
            column = int(np.searchsorted(both, aimed))
            order = self._mirror if turned else slice(None)
            if turned and (self._mirror == np.arange(len(self._mirror))).all():
                break
            high, at = highest[:, column], node[:, column]
            near = self._aim.near[:, aimed]
            for each in np.flatnonzero(~near & (high >= _CONSIDERED)):
                pool.setdefault((turned, int(each)), set()).add(int(at[each]))
            mine = {each: nodes for (side, each), nodes in pool.items() if side == turned}
            for which, nodes in mine.items():
                rows.append(self.sample.rows[sorted(nodes)][:, order])
                limit += [1 - _MARGIN] * len(nodes)
                slack += [len(price)] * len(nodes)
                price.append(_ELSEWHERE if self._aim.own[which] else _WRONG)
            wanted = np.flatnonzero(near & (high >= SEEN))
            nearest = self._nearest(high, aimed)
            for found, cost in ((wanted, _NEAR), (nearest, _SILENT)):
                rows.append(-self.sample.rows[at[found]][:, order])
                limit += [-1 - _MARGIN] * len(found)
                slack += range(len(price), len(price) + len(found))
                price += [cost] * len(found)
        full = np.abs(self._start_ma[site])
        most_ma = np.where(self._driven, np.minimum(full.max(), self._limit_ma), 0.0)
        return _Program(
            np.concatenate(rows).astype(np.float64), np.array(limit), np.array(slack, np.intp),
            np.array(price), self.current_ma[site].copy(), step * full.max(),
            np.maximum(most_ma, full), float(full.sum()),
        )  # fmt: skip

    def _nearest(self, high: Floats, site: int) -> Indices:
        """Return the afferent of each finger, within half a pitch, that is nearest to firing."""
        there = np.flatnonzero(self._aim.nearest[:, site] & (high >= SEEN))
        order = there[np.lexsort((-high[there], self.sample.finger[there]))]
        _, first = np.unique(self.sample.finger[order], return_index=True)
        return np.asarray(order[first])


class _Program(NamedTuple):
    """Linear program of a site: minimize prices·slacks with rows·w − slack ≤ limit."""

    rows: Array
    limit: Array
    slack: Indices
    price: Array
    current_ma: Array
    step_ma: float
    most_ma: Array
    sum_ma: float


def _solved(program: _Program) -> Array:
    """Return the currents that solve a program, (E,) mA."""
    from scipy import optimize
    from scipy.sparse import csr_array, eye_array, hstack, vstack

    count, slacks = program.rows.shape[1], len(program.price)
    picks = csr_array(
        (-np.ones(len(program.slack)), (np.arange(len(program.slack)), program.slack)),
        shape=(len(program.slack), slacks),
    )
    eye, none = eye_array(count), csr_array((count, slacks))
    above = vstack(
        [
            hstack([csr_array(program.rows), csr_array((len(program.rows), count)), picks]),
            hstack([eye, -eye, none]),
            hstack([-eye, -eye, none]),
            csr_array(np.r_[np.zeros(count), np.ones(count), np.zeros(slacks)][None]),
        ],
        format="csr",
    )
    limit = np.r_[program.limit, np.zeros(2 * count), program.sum_ma]
    most = program.most_ma
    lower = np.clip(program.current_ma - program.step_ma, -most, most)
    upper = np.clip(program.current_ma + program.step_ma, -most, most)
    bounds = np.concatenate(
        [
            np.c_[lower, upper],
            np.c_[np.zeros(count), most],
            np.c_[np.zeros(slacks), np.full(slacks, np.inf)],
        ]
    )
    # Of equally good patterns the one of least current.
    cost = np.r_[np.zeros(count), np.full(count, 1e-5), program.price]
    balance = csr_array(np.r_[np.ones(count), np.zeros(count + slacks)][None])
    solve: Any = optimize.linprog
    found = solve(cost, above, limit, balance, [0.0], bounds, method="highs-ds")
    if found.x is None:
        raise DesignError(
            f"the solver gave up ({found.message}): check the depths and sizes of the profile"
        )
    return np.asarray(found.x[:count])
