"""Selectivity of slots that stimulate one class at several sites."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import af_matrix, everywhere, targets
from smarttouch.profile import Profile

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@dataclass(frozen=True)
class FrameFigures:
    """Selectivity of one slot. The activation of each target is divided by the target's level.
    `off_target` and `spill` are relative to the smallest of these quotients."""

    off_target: float  # largest activation of any other class
    spill: float  # largest activation of the same class at nodes over a pitch away from all targets
    weakest: float  # smallest activation of a target, relative to its requested activation
    strongest: float  # largest activation of a target, relative to its requested activation
    total_ma: float  # total cathodic current
    electrode_ma: float  # largest current of an electrode


@dataclass(frozen=True)
class FrameBounds:
    """Largest allowed side effects of a slot.

    Raises DesignError for impossible values. The default of `other`, 0.30, is the off-target
    activation of the paper's linear program for one SAI point on the paper's line array. To save
    current, each target of a slot can be weaker than requested, by a share of up to `uneven`.
    """

    other: float = 0.30  # largest allowed `FrameFigures.off_target`
    spill: float = 0.30  # largest allowed `FrameFigures.spill`
    uneven: float = 0.05  # largest allowed relative error of a target's activation

    def __post_init__(self) -> None:
        for name, value in (("other", self.other), ("spill", self.spill), ("uneven", self.uneven)):
            upper_bound = 1 if name == "uneven" else np.inf
            if not 0 < value < upper_bound:
                raise DesignError(
                    f"the bound {name} is {value}: give a number above 0 (below 1 for 'uneven')"
                )


_SAME_MM = 1e-9


class FrameJudge:
    """Calculator of the selectivity of slots. A slot stimulates one class at several sites.

    `wish_af`, (E,) V/mm², is the requested activation of each target at level 1.
    """

    def __init__(self, profile: Profile, afferent: Afferent, wish_af: Array) -> None:
        if np.shape(wish_af) != (len(profile.electrodes),):
            raise DesignError(
                f"wish_af has {np.size(wish_af)} values, but the array has "
                f"{len(profile.electrodes)} electrodes: give one value for each"
            )
        self.profile: Profile = profile
        self.afferent: Afferent = afferent
        self.wish_af: Array = np.asarray(wish_af, np.float64)
        self.target: Array = af_matrix(profile, targets(profile, afferent))
        """AF rows of the targets of all sites, (E, E) V/mm² per mA."""

    @cached_property
    def others(self) -> Single:
        """AF rows of all nodes of the other classes, (N, E) V/mm² per mA."""
        others = [other for other in Afferent if other is not self.afferent]
        return np.concatenate([self._rows(other) for other in others])

    @cached_property
    def own(self) -> Single:
        """AF rows of all nodes of the class, (M, E) V/mm² per mA."""
        return self._rows(self.afferent)

    def _rows(self, afferent: Afferent) -> Single:
        nodes = everywhere(self.profile, afferent)
        return np.asarray(af_matrix(self.profile, nodes), np.float32)

    @cached_property
    def full_ma(self) -> Array:
        """Limit of each electrode at intensity 1, (E,) mA, rounded down to 1 µA; 0 if masked."""
        limits = self.profile.limits
        limit_ma = np.minimum(np.asarray(self.profile.full_ma, np.float64), limits.current_ma)
        if limits.electrode_ma is not None:
            limit_ma = np.minimum(limit_ma, np.asarray(limits.electrode_ma))
        limit_ma = np.floor(1000 * limit_ma + 1e-6) / 1000
        return np.where(np.isin(np.arange(len(limit_ma)), self.profile.driven), limit_ma, 0.0)

    @cached_property
    def uneven_af(self) -> tuple[float, float]:
        """Largest Σ|g_j − g_(j+1)| of any row g: one value for `others`, and one for `own`."""
        rows_of = self.others, self.own
        other, own_af = (float(np.abs(np.diff(rows)).sum(axis=1).max()) for rows in rows_of)
        return other, own_af

    @cached_property
    def _near(self) -> NDArray[np.bool_]:
        """Whether each node of `own` lies within a pitch of each electrode, (E, M)."""
        array, nodes = self.profile.electrodes, everywhere(self.profile, self.afferent)
        away = np.linalg.norm(array.position_mm[:, None] - nodes.position_mm, axis=2)
        return np.tile(away <= array.pitch_mm + _SAME_MM, len(nodes.direction))

    def far(self, active: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which nodes of `own`, (M,), lie more than a pitch from every active target."""
        return np.asarray(~self._near[active].any(axis=0))

    def judge(self, current: Array, level: Array) -> list[FrameFigures]:
        """Return the selectivity of slots with these currents, (S, E) mA, and levels, (S, E).
        `off_target` and `spill` are infinite if a target is not activated. Raises DesignError for a
        slot without an active site."""
        if not len(current):
            return []
        if not level.any(axis=1).all():
            raise DesignError("a slot has no active site, so it has no selectivity: leave it out")
        single = np.asarray(current, np.float32)
        rest, own_af = (single @ self.others.T).max(axis=1), single @ self.own.T
        return [
            self._figures(*slot) for slot in zip(current, level, rest.tolist(), own_af, strict=True)
        ]

    def _figures(self, current: Array, level: Array, rest: float, own: Single) -> FrameFigures:
        active = np.flatnonzero(level)
        reached = self.target[active] @ current / level[active]
        smallest, ratio = float(reached.min()), reached / self.wish_af[active]
        far = max(float(own[self.far(active)].max(initial=-np.inf)), 0.0)
        other, spill = (rest / smallest, far / smallest) if smallest > 0 else (np.inf, np.inf)
        total, strongest = float(np.abs(current).sum() / 2), float(np.abs(current).max())
        return FrameFigures(other, spill, float(ratio.min()), float(ratio.max()), total, strongest)


def full_wish(profile: Profile, kernels: Array, receptor: Array) -> Array:
    """Return the activation, (E,) V/mm², that each kernel causes at its target at the comfort
    level. Pass `KernelBank.kernels` and `KernelBank.receptor`, (E, E)."""
    return np.asarray(profile.full_ma * (receptor * kernels).sum(axis=1), np.float64)


_SOFT = 1e-6
"""Regularization of `independent`, relative to the mean response of the targets. Without it the
system of equations is singular if all sites are active, because currents sum to zero."""
AIM = 0.8  # to save current, slots give (1 − AIM · uneven) of the requested activation


class FrameOperator:
    """Solver for the kernels of sites that share slots."""

    def __init__(self, judge: FrameJudge) -> None:
        self.judge = judge
        driven, count = judge.profile.driven, len(judge.profile.electrodes)
        gram = judge.own.T.astype(np.float64) @ judge.own
        form = np.eye(count) + gram / np.trace(gram) * count
        # Masked electrodes carry no current, and currents sum to zero.
        basis = _zero_sum(len(driven))
        inner = basis.T @ form[np.ix_(driven, driven)] @ basis
        inverse = np.zeros((count, count))
        inverse[np.ix_(driven, driven)] = basis @ np.linalg.inv(inner) @ basis.T
        self._columns = inverse @ judge.target.T
        self._response = judge.target @ self._columns
        self._soft = _SOFT * float(np.trace(self._response)) / len(self._response)

    def independent(self, sites: NDArray[np.intp]) -> Array:
        """Return the kernels of some sites, (A, E) mA per V/mm². Each activates its own site and
        none of the other sites."""
        system = self._response[np.ix_(sites, sites)] + self._soft * np.eye(len(sites))
        return np.asarray(np.linalg.solve(system, self._columns[:, sites].T))


def _zero_sum(count: int) -> Array:
    """Return an orthonormal basis, (n, n − 1), of the vectors that sum to zero."""
    full, _ = np.linalg.qr(np.c_[np.ones(count), np.eye(count)[:, 1:]])
    return np.asarray(full[:, 1:])


MOST_PROVED = 300  # largest number of electrodes for `proved_sets`, which then takes about 1 s
_STEPS = (2, 3, 4)  # distances to try between the sites of a set, in rows and columns
_SINGLE = 1.0001  # safety factor for rounding errors of single precision
_HALF_UA_MA = 0.0005
_HALF_AMPLITUDE_MA = 0.000125 * (1 + 1e-9)  # half a quantization step of an amplitude
_HALF_WEIGHT = (0.5 + 1e-6) / 32_768  # half a quantization step of a weight
_WEIGHT_PEAK = 32_767 / 32_768


@dataclass(frozen=True, eq=False)
class SharedKernels:
    """Kernels of sites that may be active together, in any combination."""

    operator: FrameOperator
    sites: NDArray[np.intp]  # (A,)

    @cached_property
    def kernels(self) -> Array:
        """Kernels, (A, E) mA: row i causes the requested activation at site i and none at the other
        sites of the set."""
        return np.asarray(self.operator.independent(self.sites) * self._wish[:, None])

    @property
    def _wish(self) -> Array:
        return self.operator.judge.wish_af[self.sites]

    @cached_property
    def excited(self) -> tuple[Array, Array]:
        """Activation by each kernel, V/mm², at nodes of other classes, (A, N), and of the same
        class, (A, M). Negative values are set to 0, and so are values at nodes of the same class
        within a pitch of the site."""
        judge = self.operator.judge
        others, own_af = self.kernels @ judge.others.T, np.maximum(self.kernels @ judge.own.T, 0)
        for row, site in zip(own_af, self.sites, strict=True):
            row[~judge.far(np.array([site]))] = 0
        return np.maximum(others, 0), own_af

    @property
    def off_target(self) -> float:
        """Upper bound of `FrameFigures.off_target` over all subsets of the sites."""
        return self._against_targets(float(self.excited[0].sum(axis=0).max()))

    @property
    def spill(self) -> float:
        """Upper bound of `FrameFigures.spill` over all subsets of the sites."""
        return self._against_targets(float(self.excited[1].sum(axis=0).max()))

    @cached_property
    def totals_ma(self) -> Array:
        """Total current of each kernel, (A,). The total current of a slot is at most their sum."""
        return np.asarray(np.abs(self.kernels).sum(axis=1) / 2)

    @cached_property
    def electrode_ma(self) -> Array:
        """Upper bound of the current of each electrode, (E,), for any subset of the sites."""
        positive = np.maximum(self.kernels, 0).sum(axis=0)
        return np.asarray(np.maximum(positive, np.maximum(-self.kernels, 0).sum(axis=0)))

    @cached_property
    def weakest(self) -> float:
        """Each active target gets at least this share of its requested activation, whatever other
        sites are active. It is below 1 if all electrodes are sites, because currents sum to
        zero."""
        return float((self._reached / self._wish).min())

    def _against_targets(self, reached: float) -> float:
        """Return an activation relative to `smallest`; infinite if `smallest` is not positive."""
        return reached / self.smallest if self.smallest > 0 else np.inf

    @cached_property
    def smallest(self) -> float:
        """Lower bound, V/mm², of an active target's activation at level 1."""
        return float(self._reached.min())

    @cached_property
    def _reached(self) -> Array:
        at_targets = self.operator.judge.target[self.sites] @ self.kernels.T
        own_af = np.diag(at_targets)
        return np.asarray(own_af + np.minimum(at_targets - np.diag(own_af), 0).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Certainty:
    """Bounds on activations, V/mm², after rounding of currents. There are N sets of sites, and the
    bounds of a set hold for all its subsets.

    A slot is the sum of c_k K_k over its kernels K_k, where c_k = aim · intensity · level. p_k is
    the peak of kernel k. Rounding causes three errors (see `KernelLists.current_ua`):

    - Amplitudes are multiples of 1/4 µA. So c_k is off by at most e_k = (1/8 µA) / p_k.
    - Weights are multiples of 1/32,768 with a peak of φ = 32,767/32,768. This scales all currents
      by φ. If the peaks of a slot's kernels add up to P, the running sum of the slot's currents
      over the electrodes is off by at most P/65,536.
    - This running sum is rounded to 1 µA, which adds an error of up to 1/2 µA.

    h is the sum of the last two errors. The running sum is exactly 0 at the last electrode. By
    summation by parts, the AF at a node with row g is off by at most V(g) = h Σ|g_j − g_(j+1)|. At
    a node of another class, the AF is at most Σ_k (c_k + e_k) max(g·K_k, 0) + V(g). At target i
    with row t, it is at least φ [(c_i − e_i) T_ii + Σ_k≠i (c_k + e_k) min(T_ik, 0)] − V(t), where
    T_ik is the AF of kernel k at target i. Without stored kernels, the error is smaller: currents
    are added in double precision and rounded once.
    """

    # (2, N) largest value of activation / intensity. Row 0: other classes; row 1: same class.
    reached: Array
    rounding: Array  # (2, N) largest increase of an activation by rounding; rows as in `reached`
    target: Array  # (N,) smallest value, over targets, of activation / (level · intensity)
    lost: Array  # (N,) largest value, over targets, of activation lost by rounding / level
    total_ua: float  # largest increase of a slot's total current by rounding

    @classmethod
    def of(
        cls, sets: Sequence[SharedKernels], aim: float, faintest: float, most_ma: float
    ) -> "Certainty":
        """Return the bounds for levels from ``faintest`` to 1, for slots with a total current of at
        most ``most_ma``. Kernels aim at ``aim`` times the requested activation."""
        certainties = [cls._of_one(site_set, aim, faintest, most_ma) for site_set in sets]
        columns = np.array(certainties, np.float64).reshape(-1, 7).T
        return cls(
            columns[:2], columns[2:4], columns[4], columns[5], float(columns[6].max(initial=0))
        )

    @staticmethod
    def _of_one(
        kernels: SharedKernels, aim: float, faintest: float, most_ma: float
    ) -> tuple[float, ...]:
        judge = kernels.operator.judge
        peaks_ma = np.abs(kernels.kernels).max(axis=1)
        error = _HALF_AMPLITUDE_MA / peaks_ma
        # A peak is at most the total current of its kernel, so `most_ma` also bounds the peaks.
        peak_ma = min(most_ma, float(aim * peaks_ma.sum())) + len(peaks_ma) * _HALF_AMPLITUDE_MA
        running_ma = _HALF_UA_MA + peak_ma * _HALF_WEIGHT
        rows = judge.target[kernels.sites]
        at_targets = rows @ kernels.kernels.T
        own_af = np.diag(at_targets)
        against = np.minimum(at_targets - np.diag(own_af), 0)
        # Other kernels weaken a target most if its level is ``faintest`` and their level is 1.
        least = own_af + against.sum(axis=1) / faintest
        lost = own_af * error - against @ error
        lost += running_ma * np.abs(np.diff(rows, axis=1)).sum(axis=1)
        reached = (aim * _SINGLE * excitation.sum(axis=0).max() for excitation in kernels.excited)
        rounding = (
            _SINGLE * (error @ excitation).max() + running_ma * steps
            for excitation, steps in zip(kernels.excited, judge.uneven_af, strict=True)
        )
        total_ma = running_ma * len(judge.full_ma) + error @ kernels.totals_ma
        return (
            *reached,
            *rounding,
            aim * _WEIGHT_PEAK * float(least.min()),
            float(lost.max()) / faintest,
            1000 * float(total_ma),
        )

    def figures(self, intensity: float) -> Array:
        """Return the upper bounds of `FrameFigures.off_target` and `spill` of each set, (2, N)."""
        weakest = intensity * self.target - self.lost
        upper_bound = intensity * self.reached + self.rounding
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(weakest > 0, upper_bound / np.maximum(weakest, 0), np.inf))

    def least(self, bounds: FrameBounds) -> float:
        """Return the lowest intensity above which all bounds hold; infinite if they never do."""
        bounds_column = np.array([[bounds.other], [bounds.spill]])
        room = bounds_column * self.target - self.reached
        needed = self.rounding + bounds_column * self.lost
        if (room <= 0).any():
            return np.inf
        return float((needed / room).max(initial=0))


def color_classes(operator: FrameOperator, step: int) -> list[SharedKernels]:
    """Return sets of sites. Two sites are in one set if their rows are equal modulo ``step``, and
    their columns, too. Raises DesignError if the array is not a grid."""
    array, driven = operator.judge.profile.electrodes, operator.judge.profile.driven
    x, column = np.unique(array.position_mm[:, 0].round(6), return_inverse=True)
    y, row = np.unique(array.position_mm[:, 1].round(6), return_inverse=True)
    if len(x) * len(y) != len(array):
        message = "the array is not a grid: choose the sites of each set yourself"
        raise DesignError(message)
    color = (row % step) * step + column % step
    sets = (driven[color[driven] == color_index] for color_index in range(step * step))
    return [SharedKernels(operator, sites) for sites in sets if len(sites)]


def provable(profile: Profile) -> bool:
    """Return whether `proved_sets` can search this array: a grid of up to `MOST_PROVED` sites."""
    return profile.array.layout == "grid" and len(profile.electrodes) <= MOST_PROVED


def proved_sets(judge: FrameJudge, bounds: FrameBounds) -> list[SharedKernels]:
    """Return sets of independent sites: whichever sites of one set share a slot, the bounds hold.

    Each site is in one set. The proof assumes reduced activations (see `AIM`). The limit of each
    electrode is checked, but not the total current. The list is empty if the array is too large or
    not a grid, or if no step of `_STEPS` gives sets that keep the bounds.
    """
    if not provable(judge.profile):
        return []
    aim, operator = 1 - AIM * bounds.uneven, FrameOperator(judge)
    for step in _STEPS:
        sets = color_classes(operator, step)
        if all(
            site_set.off_target <= bounds.other
            and site_set.spill <= bounds.spill
            and aim * site_set.weakest >= 1 - bounds.uneven
            and (aim * site_set.electrode_ma <= judge.full_ma).all()
            for site_set in sets
        ):
            return sets
    return []
