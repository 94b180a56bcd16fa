"""Solver for min–max linear programs with few unknowns and very many rows.

It starts with a few rows. Each round solves the program and adds the rows that the solution
violates most, until it violates none. A round first checks a coarse subset. Then it checks the rows
that were nearly violated at the last check of all rows, and finally all rows. HiGHS continues from
its last basis, so a round costs a few pivots. The final solution is proven optimal by its dual.
"""

from collections.abc import Callable, Sequence

import highspy
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError

Array = NDArray[np.float64]
Chooser = Callable[[Array], NDArray[np.intp]]
Options = dict[str, str | int | float | bool]

_TOLERANCE = 1e-7
_PRICE = 1e-10  # magnitude above which a dual counts as nonzero
_ROWS_AT_ONCE = 60
_NEAR = 0.02  # slack below which a row counts as nearly violated
_MOST_NEAR = 8000
_BOX = 1e3  # largest magnitude of an unknown; without it, the first rounds would be unbounded
_OPTIONS: Options = {
    "output_flag": False,
    "threads": 1,
    "presolve": "off",
    # Use Devex weights, because exact steepest-edge weights are recomputed at every hot start.
    "simplex_dual_edge_weight_strategy": 1,
}

_PATIENCE = 10  # a hot start counts as cycling after _PATIENCE × (rows + columns) iterations
_RESCUES: tuple[Options, ...] = (
    {"simplex_dual_edge_weight_strategy": -1},
    {"solver": "ipm", "presolve": "on"},
)
"""If a solution cannot be verified, the solver starts anew with each of these options in turn."""


class _SilentHighs(highspy.Highs):
    """HiGHS without output. Version 1.16 prints a banner before an option can disable it."""

    def __init__(self) -> None:
        # mypy rejects super().__init__(): the method has no type annotations.
        highspy.Highs.__init__(self)

    def enableCallbacks(self) -> None:  # noqa: N802, the name that the library calls
        self.setOptionValue("output_flag", False)
        highspy.Highs.enableCallbacks(self)


class ProgramRows:
    """Rows of a program, (N, O). A row is the product of an AF row, (E,), and the orbits of a site,
    (E, O). To save memory, only the factors are stored: all sites share the AF rows.

    Each of ``parts`` has three items: an array of AF rows, their divisor, and the indices of the
    rows to use (None for all). Rows with indices ``coarse``, (K,), are checked first.
    """

    def __init__(
        self,
        parts: Sequence[tuple[Array, float, NDArray[np.intp] | None]],
        orbits: Array,
        coarse: NDArray[np.intp] | None = None,
    ) -> None:
        self._parts = parts
        self.orbits: Array = orbits
        counts = [len(rows) if chosen is None else len(chosen) for rows, _, chosen in parts]
        self._ends = np.cumsum(counts)
        self.coarse: NDArray[np.intp] = np.arange(len(self)) if coarse is None else coarse
        self.coarse_rows: Array = self.take(self.coarse)

    def __len__(self) -> int:
        return int(self._ends[-1])

    def times(self, weights: Array) -> Array:
        """Multiply all rows by a pattern, (O,). Return the products, (N,)."""
        pattern = self.orbits @ weights
        products = []
        for rows, scale, chosen in self._parts:
            product = rows @ pattern / scale
            products.append(product if chosen is None else product[chosen])
        return np.concatenate(products)

    def take(self, index: NDArray[np.intp]) -> Array:
        """Return the rows with these indices, (K, O)."""
        taken, part = (
            np.empty((len(index), self.orbits.shape[1])),
            self._ends.searchsorted(index, "right"),
        )
        for which, (rows, scale, chosen) in enumerate(self._parts):
            mine = np.flatnonzero(part == which)
            begin = self._ends[which] - (len(rows) if chosen is None else len(chosen))
            row_index = index[mine] - begin
            taken[mine] = (
                rows[row_index if chosen is None else chosen[row_index]] @ self.orbits / scale
            )
        return taken


class LinearProgram:
    """Linear program: minimize t such that rows·w ≤ slope·t + bound, aims·w ≥ 1, Σ size·w = 0.

    An orbit is a set of electrodes with equal currents. w, (O,), is the current of one electrode of
    each orbit. ``size``, (O,), is the number of its electrodes. If several patterns are optimal,
    the costs in ``ties``, (O,) each, decide in turn: each keeps those with the smallest Σ cost·|w|.
    The program is solved with some of its rows, then again with rows that were violated.
    ``worst`` chooses the rows to add from the excess of each row, (N,); by default, it chooses all
    violated rows. With a solved program ``after``, start with its rows and require t ≥ 0.
    """

    def __init__(
        self,
        rows: ProgramRows,  # (N, O)
        slope: Array,  # (N,) 1 if the upper bound of rows·w is t, else 0
        bound: Array,  # (N,) upper bound of rows·w; 0 if the upper bound is t
        aims: Array,  # (S, O) aims·w is at least 1 for each row; it is exactly 1 if S is 1
        size: Array,
        ties: Sequence[Array],
        worst: Chooser | None = None,
        options: Options | None = None,
        after: "LinearProgram | None" = None,
    ) -> None:
        self._rows, self._slope, self._bound = rows, slope, bound
        self._size, self._ties = size, ties
        self._worst = worst or (lambda excess: np.flatnonzero(excess > _TOLERANCE))
        self._count = rows.orbits.shape[1]
        self._used = np.zeros(len(rows), bool)
        self._near: NDArray[np.intp] = np.zeros(0, np.intp) if after is None else after._near
        self._near_rows: Array = np.zeros((0, self._count)) if after is None else after._near_rows
        self._solver = _SilentHighs()
        for name, value in (_OPTIONS | (options or {})).items():
            self._solver.setOptionValue(name, value)
        self._solver.addVars(
            self._count + 1,
            np.r_[np.full(self._count, -_BOX), -1.0 if after is None else 0.0],
            np.full(self._count + 1, _BOX),
        )
        self._cost(np.r_[np.zeros(self._count), 1.0])
        exact = 1.0 if len(aims) == 1 else np.inf
        self._add(np.c_[aims, np.zeros(len(aims))], 1.0, np.full(len(aims), exact))
        self._add(np.r_[size, 0.0][None], 0.0, np.zeros(1))
        # Start with the rows that have the extreme values of each column: they usually bind.
        coarse = rows.coarse_rows
        first = rows.coarse[np.unique(np.r_[coarse.argmax(axis=0), coarse.argmin(axis=0)])]
        self._use(first if after is None else np.flatnonzero(after._used))

    def most_selective(self) -> float:
        """Minimize the objective t, and return it; infinite if no pattern is feasible."""
        answer = self._solve()
        return np.inf if answer is None else float(answer[self._count])

    @property
    def pattern(self) -> Array:
        """Pattern of the last solution, (O,)."""
        return np.asarray(self._solver.getSolution().col_value)[: self._count]

    @property
    def unique(self) -> bool:
        """True if the optimum is proven unique: it has as many nonzero duals as columns."""
        solution = self._solver.getSolution()
        prices = np.r_[solution.row_dual, solution.col_dual]
        return int((np.abs(prices) > _PRICE).sum()) >= self._columns

    def limit(self, reference: Array, factors: Array, total: float | None) -> None:
        """Limit magnitudes of currents to multiples of a reference current, reference·w.
        ``reference``, (O,), usually selects one electrode. ``factors``, (O,), has the multiple for
        each current. ``total`` is the multiple for the sum of the magnitudes over all electrodes.
        An infinite factor, or a ``total`` of None, sets no limit."""
        bounded = np.flatnonzero(np.isfinite(factors))
        eye = np.eye(self._count)[bounded]
        push = factors[bounded, None] * reference
        zero = np.zeros((len(bounded), self._columns - self._count))
        for sign in (1.0, -1.0):
            self._add(np.c_[sign * eye - push, zero], -np.inf, np.zeros(len(bounded)))
        if total is not None:
            self._add_magnitudes()
            row = np.r_[-total * reference, 0.0, self._size]
            self._add(row[None], -np.inf, np.zeros(1))

    def settled(self) -> Array:
        """Return the optimal pattern, (O,). If several are optimal, `ties` decide."""
        for prices in self._ties:
            if self.unique:
                break
            self._keep_optimum()
            self._add_magnitudes()
            self._cost(np.r_[np.zeros(self._count + 1), prices])
            if self._solve() is None:
                message = "the solver cannot reproduce its optimum: raise the limits a little"
                raise DesignError(message)
        return self.pattern

    def _keep_optimum(self) -> None:
        """Restrict the program to optimal patterns: bounds with a nonzero dual become
        equalities."""
        solution, model = self._solver.getSolution(), self._solver.getLp()
        duals, reduced = np.asarray(solution.row_dual), np.asarray(solution.col_dual)
        side = np.where(duals > 0, model.row_lower_, model.row_upper_)
        for row in np.flatnonzero(np.abs(duals) > _PRICE):
            self._solver.changeRowBounds(int(row), float(side[row]), float(side[row]))
        values = np.asarray(solution.col_value)
        fixed = np.abs(reduced) > _PRICE
        fixed[self._count] = True
        for column in np.flatnonzero(fixed):
            value = float(values[column])
            self._solver.changeColBounds(int(column), value, value)

    # -- the solver --------------------------------------------------------

    def _solve(self) -> Array | None:
        rescues = iter(_RESCUES)
        is_cold = False
        while True:
            rows, columns = self._solver.getNumRow(), self._columns
            self._solver.setOptionValue("simplex_iteration_limit", _PATIENCE * (rows + columns))
            self._solver.run()
            status = self._solver.getModelStatus()
            if status == highspy.HighsModelStatus.kOptimal:
                answer = np.asarray(self._solver.getSolution().col_value)
                weights, worst = answer[: self._count], answer[self._count]
                if len(violated := self._violated(weights, float(worst))):
                    self._use(violated)
                    continue
                if is_cold or self._proven(answer):
                    return answer
            elif is_cold and status == highspy.HighsModelStatus.kInfeasible:
                return None
            # A hot start can fail or cycle. From now on accept only the results of cold starts.
            is_cold = True
            self._solver.clearSolver()
            rescue = next(rescues, None)
            if rescue is None:
                raise DesignError(
                    f"the solver gave up ({self._solver.modelStatusToString(status)}): "
                    "check depths and electrode sizes of the profile"
                )
            for name, value in rescue.items():
                self._solver.setOptionValue(name, value)

    def _proven(self, answer: Array) -> bool:
        """Return whether the duals prove the solution optimal for the rows that the solver has."""
        solution, model = self._solver.getSolution(), self._solver.getLp()
        duals, reduced = np.asarray(solution.row_dual), np.asarray(solution.col_dual)
        lower, upper = np.asarray(model.row_lower_), np.asarray(model.row_upper_)
        side = np.where(duals > 0, lower, upper)
        column = np.where(reduced > 0, model.col_lower_, model.col_upper_)
        value = float(np.asarray(model.col_cost_) @ answer)
        with np.errstate(invalid="ignore"):
            bound = float(
                np.where(duals == 0, 0.0, duals * side).sum()
                + np.where(reduced == 0, 0.0, reduced * column).sum()
            )
        return abs(value - bound) <= 1e-6 * max(1.0, abs(value))

    def _violated(self, weights: Array, worst: float) -> NDArray[np.intp]:
        """Return violated rows to add. Search the coarse rows, then `_near`, then all rows; stop as
        soon as a search finds violated rows."""
        for some, values in (
            (self._rows.coarse, self._rows.coarse_rows),
            (self._near, self._near_rows),
        ):
            excess = values @ weights - self._slope[some] * worst - self._bound[some]
            excess[self._used[some]] = -np.inf
            violated = np.flatnonzero(excess > _TOLERANCE)
            if len(violated):
                return some[self._worst_of(violated, excess)]
        excess = self._rows.times(weights) - self._slope * worst - self._bound
        excess[self._used] = -np.inf
        if not (excess > _TOLERANCE).any():
            return violated
        self._store_near(excess)
        chosen = self._worst(excess)
        if not len(chosen):
            chosen = np.flatnonzero(excess > _TOLERANCE)
        return self._worst_of(chosen, excess)

    def _store_near(self, excess: Array) -> None:
        """Store violated and nearly violated rows. Later rounds check them before all rows."""
        near = np.flatnonzero(excess > -_NEAR)
        if len(near) > _MOST_NEAR:
            near = near[np.argpartition(excess[near], -_MOST_NEAR)[-_MOST_NEAR:]]
        self._near, self._near_rows = near, self._rows.take(near)

    def _worst_of(self, chosen: NDArray[np.intp], excess: Array) -> NDArray[np.intp]:
        many = max(_ROWS_AT_ONCE, self._count // 5)
        if len(chosen) > many:
            chosen = chosen[np.argpartition(excess[chosen], -many)[-many:]]
        return chosen

    def _use(self, chosen: NDArray[np.intp]) -> None:
        self._used[chosen] = True
        coefficients = np.c_[self._rows.take(chosen), -self._slope[chosen]]
        self._add(coefficients, -np.inf, self._bound[chosen])

    @property
    def _columns(self) -> int:
        return int(self._solver.getNumCol())

    def _add(self, coefficients: Array, lower: float, upper: Array) -> None:
        count, width = coefficients.shape
        self._solver.addRows(
            count,
            np.full(count, lower),
            np.asarray(upper, np.float64),
            count * width,
            np.arange(count, dtype=np.int32) * width,
            np.tile(np.arange(width, dtype=np.int32), count),
            np.ascontiguousarray(coefficients, np.float64).ravel(),
        )

    def _add_magnitudes(self) -> None:
        """Add the magnitude of each weight as an unknown; later calls do nothing."""
        count, columns = self._count, self._columns
        if columns > count + 1:
            return
        self._solver.addVars(count, np.zeros(count), np.full(count, _BOX))
        eye = np.eye(count)
        for sign in (1.0, -1.0):
            self._add(
                np.c_[sign * eye, np.zeros(count), -eye], -np.inf, np.zeros(count)
            )  # fmt: skip

    def _cost(self, cost: Array) -> None:
        self._solver.changeColsCost(len(cost), np.arange(len(cost), dtype=np.int32), cost)
