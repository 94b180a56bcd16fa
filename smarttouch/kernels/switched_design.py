"""Kernels for boards that switch one source: cathode, anode or insulated, electrode by electrode.

A source's current divides among the electrodes of a pole by their admittance y,
so an assignment is a pattern with no freedom left, and there are 3^E of them. A
pattern beats L where, for every row a of another class and the target's row t,
the y-weighted mean of b = a − L·t over its cathodes is below that over its
anodes. A few electrodes decided bound both means whatever the others become, so
whole branches fall at once (branch and bound, Land and Doig 1960), and a few
thousand of 43 million assignments of 16 electrodes are ever looked at. Where
branches become too many, a local search has found a good assignment, and the
weighted optimum bounds how much better one could be.
"""

import itertools
from collections import Counter
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Array, Kernel, KernelKind, Problem, limits_ma
from smarttouch.kernels.weighted_design import SPILL, design_kernel
from smarttouch.profile import Profile

EXACT = 25  # largest number of electrodes for which a proof of optimality is tried
_BRANCHES = 60_000  # number of open branches at which the proof is abandoned
_BOUNDING_ROWS = 60
_AT_ONCE = 4_000_000  # largest number of activations in memory
_SLACK = 1e-9


def best_assignment(problem: Problem, site: int) -> tuple[Array, float]:
    """Return the best pattern of one source, (E,) positive cathodic, and its gap: 0 where proven
    optimal, else (reached − bound) / reached."""
    judge = _Judge(problem, site)
    states, gap = _best_states(judge, problem, site)
    pattern = np.zeros(problem.electrodes)
    pattern[problem.driven] = pole_shares(states[None], judge.admittance)[0]
    return pattern, gap


def _best_states(judge: "_Judge", problem: Problem, site: int) -> tuple[NDArray[np.int8], float]:
    states, reached = _local_search(judge, problem, site)
    if not np.isfinite(reached):
        raise DesignError(
            f"no switching pattern activates {problem.describe(site)}: its electrodes are too far "
            "apart for its depth",
            about="site",
            electrode=site,
        )
    if len(problem.driven) <= EXACT:
        away = problem.profile.electrodes.distance_mm[site, problem.driven]
        left = _not_ruled_out(judge, states, reached, np.argsort(away, kind="stable"))
        if left is not None:
            worths = judge.reached(left)
            if len(left) and worths.min() < reached - _SLACK:
                states = left[int(worths.argmin())]
            return states, 0.0
    kernel = design_kernel(problem, site, given_up=0)
    bound = max(kernel.off_target, kernel.spill if kernel.spill > SPILL + 1e-6 else 0.0)
    return states, max(0.0, (reached - bound) / reached)


def pole_shares(states: NDArray[np.int8], admittance: Array) -> Array:
    """Return currents (P, E) mA, positive cathodic, of 1 mA in states (P, E): 1 cathode, −1 anode,
    0 insulated; relative admittance (E,) divides each pole's current."""
    total = np.zeros(states.shape)
    for pole in (1, -1):
        connected = (states == pole) * admittance
        passed = connected.sum(axis=1, keepdims=True)
        total += pole * np.divide(connected, passed, out=connected, where=passed > 0)
    return total


class _Judge:
    """Worst other class of assignments of driven electrodes, or own spill where above `SPILL`, on
    the worst of the problem's skins and possible targets."""

    def __init__(self, problem: Problem, site: int) -> None:
        driven = problem.driven
        total, electrode = limits_ma(problem.profile)
        self.full_ma, self.limits_ma = problem.full_ma(site), (total, electrode[driven])
        self.site = int(np.flatnonzero(driven == site)[0])
        self.admittance = problem.profile.admittance[driven]
        far = problem.beyond_a_pitch(site)
        self.skins = [
            (rows.target[:, site, driven], rows.other[:, driven], rows.own[far][:, driven])
            for rows in problem.rows
        ]
        self._at_once = max(16, _AT_ONCE // sum(len(rows.other) for rows in problem.rows))

    def reached(self, states: NDArray[np.int8]) -> Array:
        """Return the objective of each assignment, infinite if it is invalid."""
        found = np.full(len(states), np.inf)
        both = np.flatnonzero((states == 1).any(axis=1) & (states == -1).any(axis=1))
        for chosen in self._split(both):
            shares = pole_shares(states[chosen], self.admittance)
            kept = self._within_limits(shares)
            chosen, shares = chosen[kept], shares[kept]
            worst, spill = np.full(len(chosen), -np.inf), np.zeros(len(chosen))
            for aims, other, own in self.skins:
                fired = (shares @ aims.T).min(axis=1)
                fired[fired <= _SLACK * np.abs(aims).max()] = np.nan
                worst = np.maximum(worst, (shares @ other.T).max(axis=1) / fired)
                if len(own):
                    spill = np.maximum(spill, (shares @ own.T).max(axis=1) / fired)
            worst = np.where(spill > SPILL, np.maximum(worst, spill), worst)
            found[chosen] = np.where(np.isnan(worst), np.inf, worst)
        return found

    def bounds(self, states: NDArray[np.int8], reached: float) -> Array:
        """Return rows (R, E) with which a pattern better than the best so far has a negative value.

        They are rows of another class less `reached` times rows of the target, those that are worst
        for most assignments.
        """
        times: Counter[tuple[int, int, int]] = Counter()
        for chosen in self._split(np.arange(len(states))):
            shares = pole_shares(states[chosen], self.admittance)
            found = []
            for aims, other, _ in self.skins:
                fired, activation = shares @ aims.T, shares @ other.T
                least = np.maximum(fired.min(axis=1), _SLACK * np.abs(aims).max())
                ratio = activation.max(axis=1) / least
                found.append((ratio, activation.argmax(axis=1), fired.argmin(axis=1)))
            ratios, rows, aim = (np.array(each) for each in zip(*found, strict=True))
            skin = ratios.argmax(axis=0)
            index = np.arange(len(chosen))
            times.update(
                zip(skin.tolist(), rows[skin, index].tolist(), aim[skin, index].tolist(),
                    strict=True)
            )  # fmt: skip
        return np.array(
            [
                self.skins[skin][1][row] - reached * self.skins[skin][0][aim]
                for (skin, row, aim), _ in times.most_common(_BOUNDING_ROWS)
            ]
        )

    def _split(self, index: NDArray[np.intp]) -> list[NDArray[np.intp]]:
        return np.array_split(index, max(1, len(index) // self._at_once))

    def _within_limits(self, shares: Array) -> NDArray[np.bool_]:
        """Return which patterns keep the limits at full current of their peak, (P,).

        One pole must be a single electrode: of several, the last one that touches the skin would
        carry all current.
        """
        total, electrode = self.limits_ma
        source_ma = self.full_ma / np.abs(shares).max(axis=1)
        alone = np.abs(shares).max(axis=1) > 1 - _SLACK
        carried = np.abs(shares) * source_ma[:, None]
        # What the site's own electrode may carry, the profile has checked.
        carried[:, self.site] = 0.0
        return np.asarray(alone & (source_ma <= total) & (carried <= electrode).all(axis=1))


def _local_search(judge: _Judge, problem: Problem, site: int) -> tuple[NDArray[np.int8], float]:
    """Return a good assignment and its objective: the weighted kernel cut at two levels, then
    improved by changing one or two states at a time."""
    order = np.argsort(design_kernel(problem, site, given_up=0).weights[problem.driven])
    count = len(order)
    cuts = [
        (anodes, cathodes)
        for anodes, cathodes in itertools.product(range(1, count), repeat=2)
        if anodes + cathodes <= count
    ]
    tried = np.zeros((len(cuts), count), np.int8)
    for states, (anodes, cathodes) in zip(tried, cuts, strict=True):
        states[order[:anodes]], states[order[count - cathodes :]] = -1, 1
    reached = judge.reached(tried)
    best, least = tried[int(reached.argmin())], float(reached.min())
    while True:
        around = np.array([best] * (3 * count + count * (count - 1) // 2))
        for index in range(3 * count):
            around[index, index // 3] = index % 3 - 1
        swaps = itertools.combinations(range(count), 2)
        for index, (first, second) in enumerate(swaps, 3 * count):
            around[index, [first, second]] = best[[second, first]]
        around = np.unique(around, axis=0)
        reached = judge.reached(around)
        if reached.min() >= least - _SLACK:
            return best, least
        best, least = around[int(reached.argmin())], float(reached.min())


def _not_ruled_out(
    judge: _Judge, best: NDArray[np.int8], reached: float, order: NDArray[np.intp]
) -> NDArray[np.int8] | None:
    """Return all assignments that may be better than the best, (P, E), or None if too many."""
    margin = judge.bounds(_some(best), reached)
    open_ = np.zeros((1, len(best)), np.int8)
    for depth, electrode in enumerate(order, 1):
        open_ = np.repeat(open_, 3, axis=0)
        open_[:, electrode] = np.tile(np.array([0, 1, -1], np.int8), len(open_) // 3)
        # One pole is a single electrode.
        fewer = np.minimum((open_ > 0).sum(axis=1), (open_ < 0).sum(axis=1))
        open_ = open_[fewer <= 1]
        for row in margin:
            open_ = open_[_may_beat(open_, row, judge.admittance, order[depth:])]
        if len(open_) > _BRANCHES:
            return None
    return open_


def _may_beat(
    states: NDArray[np.int8], row: Array, admittance: Array, undecided: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return which branches may have a lower mean of a row over cathodes than over anodes."""
    rising = undecided[np.argsort(row[undecided])]
    least = -_best_mean(states == 1, -row, admittance, rising)
    most = _best_mean(states == -1, row, admittance, rising[::-1])
    return np.asarray(least < most)


def _best_mean(
    decided: NDArray[np.bool_], row: Array, admittance: Array, joining: NDArray[np.intp]
) -> Array:
    """Return the largest mean that a pole can reach if electrodes join it, best first, (P,)."""
    passed = np.r_[0.0, np.cumsum(admittance[joining])]
    summed = np.r_[0.0, np.cumsum((admittance * row)[joining])]
    total = (decided @ admittance)[:, None] + passed
    mean = np.full(total.shape, -np.inf)
    np.divide((decided @ (admittance * row))[:, None] + summed, total, out=mean, where=total > 0)
    return np.asarray(mean.max(axis=1))


def _some(best: NDArray[np.int8]) -> NDArray[np.int8]:
    """Return the neighbors of an assignment and 1000 random ones, (P, E)."""
    count = len(best)
    changed = np.repeat(best[None], 3 * count, axis=0)
    changed[np.arange(3 * count), np.repeat(np.arange(count), 3)] = np.tile([-1, 0, 1], count)
    anything = np.random.default_rng(0).integers(-1, 2, (1000, count)).astype(np.int8)
    return np.concatenate([changed, anything])


def polarity(profile: Profile, afferent: Afferent) -> str:
    """Return the pole over the target of a mode (Fig. 10): cathodic over flat axons (SAI, PC),
    anodic over rising ones (RA), but cathodic over those too if their ending can fire."""
    anodic = afferent is Afferent.RA and profile.skin.ra_ending == "passive"
    return "anodic" if anodic else "cathodic"


def possible_modes(profile: Profile) -> list[Afferent]:
    """Return the modes that a profile's board can make."""
    offered = profile.output.polarities if profile.output.kind != "weighted" else ()
    return [each for each in Afferent if not offered or polarity(profile, each) in offered]


def designer(profile: Profile) -> Callable[[Problem, int], Kernel]:
    """Return the function that designs kernels for a profile's kind of board."""
    designers: dict[KernelKind, Callable[[Problem, int], Kernel]] = {
        "weighted": design_kernel,
        "three-state": design_three_state,
        "one-against-all": design_one_of_n,
    }
    return designers[profile.output.kind]


def design_three_state(problem: Problem, site: int) -> Kernel:
    """Choose cathode, anode or insulated for every electrode (paper, Fig. 19).

    The source's current divides among the electrodes of a pole by their admittance, equally unless
    ``output.impedance_kohm`` is given. The objective is that of `design_kernel`. `Kernel.gap` is 0
    where all assignments were ruled out, else the distance to the best weighted kernel, which no
    switched one can beat.
    """
    problem.check_site(site)
    share, gap = best_assignment(problem, site)
    return problem.judge(share, site, kind="three-state", gap=gap)


def design_one_of_n(problem: Problem, site: int) -> Kernel:
    """Return the only pattern of such a board: one electrode against all others.

    It connects masked electrodes too, but their share of the current is unknown and not counted.
    """
    problem.check_site(site)
    admittance = problem.profile.admittance
    others = problem.driven[problem.driven != site]
    pole = -1.0 if polarity(problem.profile, problem.afferent) == "anodic" else 1.0
    weights = np.zeros(problem.electrodes)
    weights[others] = -pole * admittance[others] / admittance[others].sum()
    weights[site] = pole
    return problem.judge(weights, site, kind="one-against-all")
