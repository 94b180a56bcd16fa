"""Optimal kernels: the min–max programme of the paper, confined to its site.

For a target node with activating-function row a, and rows A of every other
afferent (Eq. 10 to 18)::

    minimize t   such that   A w ≤ t,   a·w = 1,   Σw = 0

and, beyond the paper, rows of the target's own class farther than one pitch
may reach at most `SPILL` of the target: on a grid the paper's programme alone
lets neighbors of the same class nearly fire.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import DesignError
from smarttouch.modes.symmetry import symmetries
from smarttouch.nerve.activation import af_matrix
from smarttouch.nerve.afferents import everywhere, targets
from smarttouch.primary import Primary
from smarttouch.profile import Profile

SPILL = 0.2
"""Most own-class activation beyond one pitch, of the target's."""
_ROWS_AT_ONCE = 400
_TOLERANCE = 1e-7

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Kernel:
    """Current pattern that stimulates one afferent at one site.

    Attributes
    ----------
    weights : ndarray, (E,) float64
        Current of every electrode, positive cathodic, largest magnitude 1.
    worst_other : float
        Largest activation of any other class, of the target's.
    own_spill : float
        Largest activation of the own class beyond one pitch, of the target's.
    """

    weights: NDArray[np.float64]
    worst_other: float
    own_spill: float


class Problem:
    """The rows of one primary on one profile, shared by all its sites.

    Attributes
    ----------
    target : ndarray, (E, E)
        Row s is the AF row of the node under electrode s.
    other : ndarray, (N, E)
        Rows of every node of the other classes.
    """

    def __init__(self, profile: Profile, primary: Primary) -> None:
        self.profile, self.primary = profile, primary
        self.target = af_matrix(profile, targets(profile, primary))
        self.other = np.vstack(
            [
                af_matrix(profile, afferents)
                for each in Primary
                if each is not primary
                for afferents in everywhere(profile, each)
            ]
        )
        own = everywhere(profile, primary)
        self._own = np.vstack([af_matrix(profile, afferents) for afferents in own])
        self._own_position_mm = np.vstack([afferents.position_mm for afferents in own])
        self.symmetries = symmetries(profile, primary)

    def own_beyond_a_pitch(self, site: int) -> Array:
        """Return the own-class rows farther than one pitch from a site's target."""
        electrodes = self.profile.electrodes
        away = np.linalg.norm(self._own_position_mm - electrodes.position_mm[site], axis=1)
        return np.asarray(self._own[away > electrodes.pitch_mm + 1e-9])

    def representative(self, site: int) -> tuple[int, NDArray[np.intp]]:
        """Return the site that stands for this one, and the way from it to here."""
        moves = [(int(np.flatnonzero(move == site)[0]), move) for move in self.symmetries]
        return min(moves, key=lambda pair: pair[0])

    def judge(self, weights: Array, site: int) -> Kernel:
        """Return weights scaled to a peak of 1, with what they really do.

        Raises
        ------
        DesignError
            If they do not activate the target at all.
        """
        own_af = float(self.target[site] @ weights)
        if own_af <= 0:
            raise DesignError(
                f"the pattern at site {site} does not activate its {self.primary.name} target"
            )
        far = self.own_beyond_a_pitch(site)
        spill = float((far @ weights).max() / own_af) if len(far) else 0.0
        return Kernel(
            weights / np.abs(weights).max(), float((self.other @ weights).max() / own_af), spill
        )


def design_kernel(problem: Problem, site: int, spill: float | None = SPILL) -> Kernel:
    """Design the weighted kernel of one site.

    Among equally selective kernels the one of least total current is taken,
    then the mean over the site's own symmetries, so that the answer does not
    depend on the solver. Where electrodes stand closer than afferents lie
    deep, the bound on spill cannot be met, or only by losing the target; the
    larger of worst other and spill is then made as small as it gets, and
    `Kernel.own_spill` says what is left.

    Parameters
    ----------
    problem : Problem
        Rows of the primary and profile.
    site : int
        Electrode over the target.
    spill : float, optional
        Bound on own-class activation beyond one pitch; None for the paper's
        unconfined programme.

    Raises
    ------
    DesignError
        If there is no such site or no such kernel.
    """
    count = problem.target.shape[1]
    if not 0 <= site < count:
        raise DesignError(f"site {site} is out of range: the array has sites 0 to {count - 1}")
    target = problem.target[site]
    scale = float(np.abs(target).max())
    far = np.empty((0, count)) if spill is None else problem.own_beyond_a_pitch(site) / scale
    rows = np.vstack([problem.other / scale, far])
    equal = np.vstack([target / scale, np.ones(count)])
    others, description = len(problem.other), _describe(problem, site)
    try:
        programme = _Programme(rows, others, spill or 0.0, equal, description)
        best = programme.most_selective()
    except DesignError:
        best = np.inf
    if spill is not None and best > spill:
        evenly = _Programme(rows, len(rows), 0.0, equal, description)
        shared = evenly.most_selective()
        if shared < best - 1e-6:
            programme, best = evenly, shared
    if best == np.inf:
        raise DesignError(
            f"no kernel for {description}: the target cannot be activated; change the array, "
            "or the depths of its profile"
        )
    weights = programme.least_current(best)
    mirrors = [move for move in problem.symmetries if move[site] == site]
    return problem.judge(np.mean([weights[move] for move in mirrors], axis=0), site)


def design_all(
    problem: Problem,
    design: Callable[[Problem, int], Kernel] = design_kernel,
    progress: Callable[[int, int], None] | None = None,
) -> list[Kernel]:
    """Design every site, each distinct one once.

    Parameters
    ----------
    problem : Problem
        Rows of the primary and profile.
    design : callable
        What designs one site.
    progress : callable, optional
        Told how many distinct sites are done, of how many.
    """
    ways = [problem.representative(site) for site in range(problem.target.shape[1])]
    distinct = sorted({first for first, _ in ways})
    done: dict[int, Kernel] = {}
    for first in distinct:
        done[first] = design(problem, first)
        if progress is not None:
            progress(len(done), len(distinct))
    kernels = []
    for first, move in ways:
        weights = np.empty_like(done[first].weights)
        weights[move] = done[first].weights
        kernels.append(Kernel(weights, done[first].worst_other, done[first].own_spill))
    return kernels


def _describe(problem: Problem, site: int) -> str:
    return f"{problem.primary.name} at site {site} of {problem.profile.name or 'this profile'}"


class _Programme:
    """A min–max programme solved on the few rows that matter, checked on all."""

    def __init__(
        self, rows: Array, others: int, spill: float, equal: Array, description: str
    ) -> None:
        self._rows, self._others, self._spill = rows, others, spill
        self._equal, self._description = equal, description
        self._chosen = np.unique(np.linspace(0, len(rows) - 1, _ROWS_AT_ONCE).astype(np.intp))

    def most_selective(self) -> float:
        """Return the smallest worst other."""
        count = self._rows.shape[1]
        cost = np.r_[np.zeros(count), 1.0]
        equal = np.column_stack([self._equal, np.zeros(2)])
        bounds = [(None, None)] * (count + 1)

        def limited(chosen: NDArray[np.intp]) -> tuple[Array, Array]:
            is_other = chosen < self._others
            rows = np.column_stack([self._rows[chosen], -is_other.astype(float)])
            return rows, np.where(is_other, 0.0, self._spill)

        answer = self._solve(cost, equal, bounds, limited, lambda x: (x[:-1], x[-1]))
        return float(answer[-1])

    def least_current(self, worst: float) -> Array:
        """Return the weights of least total current that are that selective."""
        count = self._rows.shape[1]
        allowed = worst + 1e-9 * max(1.0, abs(worst))
        equal = np.column_stack([self._equal, -self._equal])

        def limited(chosen: NDArray[np.intp]) -> tuple[Array, Array]:
            rows = np.column_stack([self._rows[chosen], -self._rows[chosen]])
            return rows, np.where(chosen < self._others, allowed, self._spill)

        answer = self._solve(
            np.ones(2 * count),
            equal,
            [(0, None)] * (2 * count),
            limited,
            lambda x: (x[:count] - x[count:], allowed),
        )
        return np.asarray(answer[:count] - answer[count:])

    def _solve(
        self,
        cost: Array,
        equal: Array,
        bounds: Sequence[tuple[float | None, float | None]],
        limited: Callable[[NDArray[np.intp]], tuple[Array, Array]],
        read: Callable[[Array], tuple[Array, float]],
    ) -> Array:
        from scipy.optimize import linprog

        # The first rounds may leave directions free; a wide box keeps them finite.
        box = [(-1e4 if low is None else low, 1e4) for low, _ in bounds]
        while True:
            upper, right = limited(self._chosen)
            answer = linprog(cost, upper, right, equal, [1.0, 0.0], box, method="highs")
            if answer.status != 0:
                raise DesignError(
                    f"no kernel for {self._description}: {answer.message.split('.')[0].lower()} "
                    "; change the array, or the depths of its profile"
                )
            weights, worst = read(np.asarray(answer.x))
            excess = self._rows @ weights
            excess[: self._others] -= worst
            excess[self._others :] -= self._spill
            excess[self._chosen] = -np.inf
            broken = np.flatnonzero(excess > _TOLERANCE)
            if not len(broken):
                return np.asarray(answer.x)
            most = broken[np.argsort(excess[broken])[::-1][:_ROWS_AT_ONCE]]
            self._chosen = np.union1d(self._chosen, most)
