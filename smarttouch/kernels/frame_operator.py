"""Currents for all points of a slot at once, from precomputed matrices.

Side effects of currents w are a quadratic form wᵀMw, M the sum of the outer
products of every node's AF row, weighted by class, and of the squared currents.
The currents that activate the targets as wished, and cause the least of it, are

    w = P T_aᵀ (T_a P T_aᵀ)⁻¹ y_a

with T_a the AF rows of the *active* targets and P the inverse of M on the
driven electrodes with Σw = 0 (least squares with linear constraints; a linear
combination of the active targets' own least-disturbing kernels that makes
them independent of each other). Sites that are not active have no wish. P and T P Tᵀ are
computed once; a frame costs one system as large as it has points.

What breaks a bound then is bounded: the worst rows are added one after the
other as inequalities, and the small dual problem is solved by nonnegative
least squares (Lawson and Hanson 1974), so that only the rows that matter take
part.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.frame_fields import (
    Bounded,
    FieldMap,
    FrameBounds,
    FrameFigures,
    Single,
    masked_point,
)
from smarttouch.kernels.frame_judges import SlotJudge

Array = NDArray[np.float64]

_SOFT = 1e-6
"""Part of the targets' mean response that keeps systems solvable if all sites are active."""
_SOFT_BOUND = 1e-5
_STEPS = 3
_ROUNDS = 8
_ROWS_AT_ONCE = 12
_HOPELESS = 1.6
"""Ratio of the least-disturbing currents' total to the limit above which none keep it."""
_PROGRESS = 0.9  # remaining part of the excess after a round, above which the search ends
_PATIENT_ROUNDS = 3
AIM = 0.8  # part of the allowed unevenness by which all targets are made weaker, to save current
_CELL = 3  # lattice steps within which one broken row represents its neighbors
_INSIDE = 0.985  # part of a bound that is the goal


@dataclass(frozen=True)
class Weights:
    """Weights of the quadratic form; each class relative to its own mean."""

    other: float  # nodes of the other classes
    own: float  # nodes of the class that is to fire
    current: float  # squared currents


CHOSEN = Weights(other=0.0, own=1.0, current=1.0)
"""By measurement for RA and SAI alike (benchmarks/test_frames.py): least field of the own class.

With less weight on currents frames are a little more selective, but a point of 32 x 32 electrodes
then takes up to 5 mA instead of 2.5, and fewer share a slot.

The other classes in the form, where both signs count, cost more than they save: a node
that is pushed down harms nobody. Their positive sides are bounded in `FrameOperator.bounded`.
"""


class FrameOperator:
    """Solver for the currents of one slot; its P points are the judge's sites, of each class."""

    def __init__(self, judge: SlotJudge, weights: Weights = CHOSEN) -> None:
        self.judge = judge
        driven = judge.profile.driven
        count = len(judge.profile.electrodes)
        self._masked = ~np.isin(np.arange(len(judge.target)) % count, driven)
        form = weights.current * np.eye(count)
        for factor, fields in ((weights.other, judge.unwanted), (weights.own, judge.wanted)):
            for field in fields:
                gram = field.gram()
                form += factor * gram / np.trace(gram) * count
        # Masked electrodes carry nothing, and all currents sum to zero.
        basis = _zero_sum(len(driven))
        inner = basis.T @ form[np.ix_(driven, driven)] @ basis
        self._inverse = np.zeros((count, count))
        self._inverse[np.ix_(driven, driven)] = basis @ np.linalg.inv(inner) @ basis.T
        self._columns = self._inverse @ judge.target.T
        self._response = judge.target @ self._columns
        self._soft = _SOFT * float(np.trace(self._response)) / len(self._response)

    def currents(self, level: Array) -> Array:
        """Return the currents (E,) mA with the least side effects for levels (E,)."""
        active = self._active(level)
        wish = level[active] * self.judge.wish_af[active]
        return np.asarray(self._columns[:, active] @ np.linalg.solve(self._system(active), wish))

    def independent(self, sites: NDArray[np.intp]) -> Array:
        """Return kernels (A, E) mA per V/mm² of a set of sites that do not disturb one another."""
        return np.asarray(np.linalg.solve(self._system(sites), self._columns[:, sites].T))

    def bounded(
        self, level: Array, bounds: FrameBounds, total_ma: float | None = None
    ) -> tuple[Array, FrameFigures]:
        """Return currents (E,) mA and figures for levels (E,), within bounds as far as possible."""
        judge, active = self.judge, self._active(level)
        limit = judge.profile.limits.total_ma if total_ma is None else total_ma
        wish = (1 - AIM * bounds.uneven) * level[active] * judge.wish_af[active]
        columns = self._columns[:, active]
        # As many as targets that are currents' own: what gives one of them 1 and the others 0.
        each = np.linalg.solve(self._system(active), columns.T).T
        free = each @ wish
        allowed = judge.limits(active, bounds, 1 - AIM * bounds.uneven)
        current, best = free, None
        rows, limits = np.zeros((0, len(free))), np.zeros(0)
        for done in range(_ROUNDS + 1):
            reached = judge.reached(current)
            figures = judge.judge(current, level, reached)
            excess = _excess(judge, figures, bounds, current, limit)
            stuck = best is not None and excess > _PROGRESS * best[0]
            if best is None or excess < best[0]:
                best = excess, current, figures
            if excess <= 0 or (stuck and done >= _PATIENT_ROUNDS):
                break
            if limit is not None and not done and figures.total_ma > _HOPELESS * limit:
                break
            more, at_most = _broken_rows(allowed, judge.full_ma, limit, current, reached)
            if not len(more):
                break
            rows, limits = np.concatenate([rows, more]), np.concatenate([limits, at_most])
            # Rows that end at a bound, in the currents that change no target.
            moved = self._inverse @ rows.T
            moved -= each @ (columns.T @ rows.T)
            price = _prices(rows @ moved, rows @ free - limits)
            if price is None:
                break
            current = free - moved @ price
            rows, limits = rows[price > 0], limits[price > 0]
        assert best is not None
        return best[1], best[2]

    def _active(self, level: Array) -> NDArray[np.intp]:
        active = np.flatnonzero(level)
        masked = self._masked[active]
        if masked.any():
            raise masked_point(int(active[masked][0]))
        return active

    def _system(self, active: NDArray[np.intp]) -> Array:
        return self._response[np.ix_(active, active)] + self._soft * np.eye(len(active))


def _broken_rows(
    allowed: list[Bounded],
    full_ma: Array,
    total_ma: float | None,
    current: Array,
    reached: list[Single],
) -> tuple[Array, Array]:
    """Return the rows (K, E) of nodes and limits that currents break, and their bounds (K,)."""
    rows, limits = [np.zeros((0, len(current)))], [np.zeros(0)]
    for (field, most, where), values in zip(allowed, reached, strict=True):
        bound = _INSIDE * most
        chosen = _hills(field, values, bound, where)
        if not len(chosen):
            continue
        rows.append(field.rows(chosen))
        limits.append(np.full(len(chosen), bound))
    over = np.flatnonzero(np.abs(current) > _INSIDE * full_ma)
    if len(over):
        rows.append(np.sign(current[over])[:, None] * np.eye(len(current))[over])
        limits.append(_INSIDE * full_ma[over])
    if total_ma is not None and np.abs(current).sum() > 2 * _INSIDE * total_ma:
        # Whatever the signs, their sum with the currents is no more than all magnitudes.
        rows.append(np.sign(current)[None] / 2)
        limits.append(np.array([_INSIDE * total_ma]))
    return np.concatenate(rows), np.concatenate(limits)


def _hills(
    field: FieldMap, values: Single, bound: float, where: NDArray[np.bool_] | None
) -> NDArray[np.intp]:
    """Return the worst rows above a bound, one per cell of the lattice."""
    index = np.flatnonzero(values > bound)
    if where is not None:
        index = index[where[index]]
    if not len(index):
        return index
    index = index[np.argsort(-(values[index] - bound))]
    line, column = np.divmod(index, field.grid[1])
    cell = line // _CELL * (field.grid[1] // _CELL + 1) + column // _CELL
    first: dict[int, int] = {}
    for place, each in enumerate(cell.tolist()):
        if first.setdefault(each, place) == place and len(first) == _ROWS_AT_ONCE:
            break
    return index[list(first.values())]


def _prices(form: Array, excess: Array) -> Array | None:
    """Minimize ½ λᵀ form λ − excess·λ over λ ≥ 0; slightly soft, as bounds may contradict.

    None where that takes too long: only bounds that contradict one another do.
    """
    # Only plans need it, and every program would take a fifth of a second longer to begin.
    from scipy.optimize import nnls

    scale = float(np.trace(form)) / len(form)
    root = np.linalg.cholesky(form + _SOFT_BOUND * scale * np.eye(len(form)))
    wanted = np.linalg.solve(root, excess)
    try:
        return np.asarray(nnls(root.T, wanted, maxiter=_STEPS * len(form))[0])
    except RuntimeError:
        return None


def keeps(
    judge: SlotJudge,
    figures: FrameFigures,
    bounds: FrameBounds,
    current: Array,
    total_ma: float | None,
) -> bool:
    """Return whether currents (E,) mA with these figures keep bounds and limits."""
    return _excess(judge, figures, bounds, current, total_ma) <= 0


def _excess(
    judge: SlotJudge,
    figures: FrameFigures,
    bounds: FrameBounds,
    current: Array,
    total_ma: float | None,
) -> float:
    """Return the relative excess over the worst bound; 0 or less if none is broken."""
    most, strength = judge.full_ma, np.abs(current)
    masked = most == 0
    idle = masked.any()
    parts = [
        figures.off_target / bounds.other,
        figures.spill / bounds.spill,
        float((strength[~masked] / most[~masked] if idle else strength / most).max()),
        np.inf if idle and current[masked].any() else 0.0,
        (1 - figures.weakest) / bounds.uneven,
        (figures.strongest - 1) / bounds.uneven,
    ]
    if total_ma is not None:
        parts.append(figures.total_ma / total_ma)
    return max(parts) - 1


def _zero_sum(count: int) -> Array:
    """Return an orthonormal basis of the vectors that sum to zero, (n, n − 1)."""
    full, _ = np.linalg.qr(np.c_[np.ones(count), np.eye(count)[:, 1:]])
    return np.asarray(full[:, 1:])
