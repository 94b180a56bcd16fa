"""Optimal currents for all points of one slot: a linear program over every node, the reference.

Minimize t over currents w such that, with r the smallest wish::

    rows of other classes · w ≤ t r     own rows beyond a pitch · w ≤ spill r
    wish (1 − uneven) ≤ target rows · w ≤ wish (1 + uneven)
    Σw = 0,   |w| ≤ limit of each electrode,   Σ|w| / 2 ≤ total

Rows are added as they are broken (as in `program`), read from the field maps,
so that not all of them need to be kept. Every electrode has two unknowns, what
it carries as a cathode and as an anode: totals are then linear.
"""

from dataclasses import dataclass

import highspy
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FieldMap, FrameBounds, FrameFigures
from smarttouch.kernels.frame_judges import FrameJudge

Array = NDArray[np.float64]

_TOLERANCE = 1e-5
"""Tolerance of a row, as a part of the smallest wish; fields are single precision."""
_ROWS_AT_ONCE = 100
_CELL = 3
_ROUNDS = 60
_AGREE = 1e-4


@dataclass(frozen=True, eq=False)
class JointOptimum:
    """Optimum of one slot: currents (E,) mA, smallest t, and number of solver runs and rows."""

    current: Array
    figures: FrameFigures
    optimum: float
    rounds_n: int
    rows_n: int


def joint_programme(
    judge: FrameJudge,
    level: Array,
    bounds: FrameBounds,
    total_ma: float | None = None,
    electrode_ma: Array | None = None,
) -> JointOptimum:
    """Return the currents with the least worst other for levels (E,) of the wish, 0 for none.

    Bounds are spill and unevenness; None leaves the total free, and electrodes have by default
    what the judge allows. Raises DesignError if no currents keep the bounds, or the solver fails.
    """
    return _Joint(judge, level, bounds, total_ma, electrode_ma).solve()


class _Joint:
    def __init__(
        self,
        judge: FrameJudge,
        level: Array,
        bounds: FrameBounds,
        total_ma: float | None,
        electrode_ma: Array | None,
    ) -> None:
        self._judge, self._level = judge, level
        active = np.flatnonzero(level)
        wish = level[active] * judge.wish_af[active]
        # Level 1 of the weakest target, which others are compared with.
        self._smallest = float(judge.wish_af[active].min()) * (1 - bounds.uneven)
        self._count = count = len(level)
        self._fields: list[tuple[FieldMap, bool, NDArray[np.bool_] | None]] = [
            (field, True, None) for field in judge.others
        ]
        self._fields.append((judge.own, False, judge.far(active)))
        self._given = [np.zeros(field.rows_n, np.bool_) for field, _, _ in self._fields]
        self._spill = bounds.spill
        self._solver = highspy.Highs()
        for name, value in (("output_flag", False), ("threads", 1), ("presolve", "off")):
            self._solver.setOptionValue(name, value)
        most = judge.full_ma if electrode_ma is None else electrode_ma
        upper = np.r_[most, most, 1e3]
        self._solver.addVars(2 * count + 1, np.zeros(2 * count + 1), upper)
        cost = np.r_[np.zeros(2 * count), 1.0]
        self._solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), cost)
        aims = judge.target[active] / wish[:, None]
        self._add(
            np.c_[aims, -aims, np.zeros(len(aims))],
            np.full(len(aims), 1 - bounds.uneven),
            np.full(len(aims), 1 + bounds.uneven),
        )
        ones, none = np.ones(count), np.zeros(count)
        self._add(np.r_[ones, -ones, 0.0][None], np.zeros(1), np.zeros(1))
        if total_ma is not None:
            self._add(np.r_[ones, none, 0.0][None], np.full(1, -np.inf), np.full(1, total_ma))

    def solve(self) -> JointOptimum:
        """Add broken rows until none is left; accept only a result confirmed by a cold start."""
        rounds, cold = 0, False
        while rounds < _ROUNDS:
            self._solver.run()
            rounds += 1
            status = self._solver.getModelStatus()
            if status == highspy.HighsModelStatus.kInfeasible and cold:
                raise DesignError(
                    "no currents activate all points of this slot within its bounds: use more "
                    "slots, or loosen the bounds",
                    about="slot",
                )
            if status != highspy.HighsModelStatus.kOptimal:
                if cold:
                    raise DesignError(
                        f"the solver gave up ({self._solver.modelStatusToString(status)}): "
                        "check the depths and sizes of the profile",
                        about="solver",
                    )
                self._solver.clearSolver()
                cold = True
                continue
            answer = np.asarray(self._solver.getSolution().col_value)
            current = answer[: self._count] - answer[self._count : 2 * self._count]
            if self._give_broken(current, float(answer[-1])):
                cold = False
                continue
            if cold:
                return JointOptimum(
                    current, self._judge.judge(current, self._level), float(answer[-1]), rounds,
                    int(self._solver.getNumRow()),
                )  # fmt: skip
            self._solver.clearSolver()
            cold = True
        message = f"no optimum after {rounds} rounds: loosen the bounds a little"
        raise DesignError(message, about="solver")

    def _give_broken(self, current: Array, worst: float) -> int:
        added = 0
        for (field, other, where), given in zip(self._fields, self._given, strict=True):
            reached = field(current[None])[0] / self._smallest
            excess = reached - (worst if other else self._spill)
            excess[given] = -np.inf
            if where is not None:
                excess[~where] = -np.inf
            chosen = _worst(field, excess)
            if not len(chosen):
                continue
            given[chosen] = True
            rows = field.rows(chosen) / self._smallest
            slope = np.full(len(rows), -1.0 if other else 0.0)
            bound = np.full(len(rows), 0.0 if other else self._spill)
            self._add(np.c_[rows, -rows, slope], np.full(len(rows), -np.inf), bound)
            added += len(chosen)
        return added

    def _add(self, coefficients: Array, lower: Array, upper: Array) -> None:
        count, width = coefficients.shape
        self._solver.addRows(
            count, lower, upper, count * width, np.arange(count, dtype=np.int32) * width,
            np.tile(np.arange(width, dtype=np.int32), count),
            np.ascontiguousarray(coefficients, np.float64).ravel(),
        )  # fmt: skip


def _worst(field: FieldMap, excess: Array) -> NDArray[np.intp]:
    """Return the worst broken rows, one per cell of the lattice."""
    index = np.flatnonzero(excess > _TOLERANCE)
    index = index[np.argsort(-excess[index])]
    line, column = np.divmod(index, field.grid[1])
    cell = line // _CELL * (field.grid[1] // _CELL + 1) + column // _CELL
    _, first = np.unique(cell, return_index=True)
    return np.asarray(index[np.sort(first)[:_ROWS_AT_ONCE]])
