"""Design of optimal kernels by the paper's min–max program, with a bound on spill.

Row a is the activating function (AF) at the target node for 1 mA through each electrode. The rows
of A are the AF at all nodes of other classes. The paper's program (Eq. 10 to 18) is::

    minimize t   such that   A w ≤ t,   a·w = 1,   Σw = 0

The AF at all other nodes of the target's axon is at most 1 (Eq. 11). Spill, the activation of the
same class more than a pitch away, is at most `SPILL`. The paper has no such bound. Without it,
neighbors of the same class would nearly fire on a grid. The design takes the pattern with the least
spill among those whose t exceeds the minimum by at most the fraction `GIVEN_UP`.
"""

import numpy as np
from scipy.ndimage import maximum_filter

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.design_problem import Array, Kernel, Problem, limits_ma
from smarttouch.kernels.linear_program import Chooser, LinearProgram, Options, ProgramRows

SPILL = 0.2  # largest allowed `Kernel.spill`
GIVEN_UP = 0.03
"""To reduce spill, off-target activation may exceed its minimum by this fraction of the minimum."""
_WORTHWHILE = 1e-6
_SEARCHED_MM = 0.5  # spacing of the nodes that `design_any_node` tries as target
_LOOSE_ROWS = 40  # largest number of rows added per round for the spill bound and Eq. 11 together


def design_kernel(
    problem: Problem,
    site: int,
    spill: float | None = SPILL,
    node: int = 0,
    options: Options | None = None,
    given_up: float = GIVEN_UP,
) -> Kernel:
    """Design the weighted kernel of one site.

    Raises DesignError if no kernel keeps the limits. To reduce spill, off-target may exceed its
    minimum by the fraction `given_up`. If `given_up` is 0, spill is not minimized.

    Of several optimal kernels, a symmetric one is taken, then the one with the least total current,
    then the one with currents nearest to the site, then nearest to the array's middle. So the
    result does not depend on the solver.

    `spill` is the largest allowed spill; None sets no bound, as in the paper. If the pitch is
    smaller than the depth of afferents, it may be that no kernel keeps the bound. Then the larger
    of off-target and spill is minimized first. No current exceeds a thousand times the current that
    the best single electrode needs. `node` is the index of the target on its axon; node 0 is under
    the electrode.
    """
    problem.check_site(site)
    rows = _ProgramBuilder(problem, site, spill, node)
    if spill is None:
        ways = [False]
    else:
        # PC kernels rarely keep the spill bound: first minimize the larger of off-target and spill.
        ways = [True, False] if problem.afferent is Afferent.PC else [False, True]
    program = rows.program(ways[0], options)
    best = program.most_selective()
    if spill is not None and (best > spill) != ways[0]:
        other = rows.program(ways[1], options)
        pattern = other.most_selective()
        if pattern < best - _WORTHWHILE:
            program, best = other, pattern
    if best == np.inf:
        raise DesignError(
            f"no kernel for {problem.describe(site)}: the target cannot be activated; change the "
            "array, or the afferent depths in its profile",
            electrode=site,
        )
    if rows.break_limits(program) and rows.limit(program):
        best = program.most_selective()
        if best == np.inf:
            raise DesignError(
                f"no kernel for {problem.describe(site)} keeps limits.total_ma and "
                "limits.electrode_ma of the profile: raise them, or lower the comfort level",
                electrode=site,
            )
    if spill is not None and given_up > 0:
        program = rows.least_spill(program, best + given_up * abs(best), options)
    weights = rows.orbits @ program.settled()
    return problem.judge(weights, site, node)


def design_any_node(problem: Problem, site: int) -> Kernel:
    """Return the best kernel over all target nodes of a site's axon (Eq. 13 to 15). If nodes are
    denser than `_SEARCHED_MM`, try only nodes about `_SEARCHED_MM` apart."""
    problem.check_site(site)
    nodes = problem.axon_mm(site)
    away = np.linalg.norm(nodes - nodes[0], axis=1) / _SEARCHED_MM
    half = problem.profile.skin.node_spacing_mm / _SEARCHED_MM / 2
    tried = (
        np.flatnonzero(np.abs(away - np.round(away)) <= half) if half < 0.5 else range(len(away))
    )
    best, worst = 0, np.inf
    for node in tried:
        try:
            kernel = design_kernel(problem, site, SPILL, int(node), given_up=0)
        except DesignError:
            if node == 0:
                raise
            continue
        if max(kernel.off_target, kernel.spill) < worst - _WORTHWHILE:
            best, worst = int(node), max(kernel.off_target, kernel.spill)
    return design_kernel(problem, site, SPILL, best)


class _ProgramBuilder:
    """Builder of the linear programs of one site. Rows are divided by the largest AF that 1 mA
    through a single electrode causes at the target."""

    def __init__(self, problem: Problem, site: int, spill: float | None, node: int) -> None:
        self._problem, self._site = problem, site
        alone = np.eye(problem.electrodes)[:, problem.driven]
        self.orbits = problem.orbits(site) if node == 0 else alone
        far = problem.beyond_a_pitch(site, node) if spill is not None else np.zeros(0, np.intp)
        far = np.flatnonzero(far)
        axon, scale = problem.axon(site), float(np.abs(problem.target[site]).max())
        aim = axon[node] if node else problem.target[site]
        # Eq. 11: no other node of the axon is activated more than the target.
        eq11 = np.delete(axon, node, axis=0)
        counts = [len(problem.other), len(far), len(eq11)]
        own_too = np.isin(far, problem.coarse_own).nonzero()[0]
        coarse = np.concatenate(
            [
                problem.coarse_other,
                own_too + counts[0],
                np.arange(counts[0] + counts[1], sum(counts)),
            ]
        )
        parts = [(problem.other, scale, None), (problem.own, scale, far), (eq11, scale, None)]
        self._rows = ProgramRows(parts, self.orbits, coarse)
        self._aims = (aim / scale)[None] @ self.orbits
        self._slope = np.repeat([1.0, 0.0, 0.0], counts)
        self._even_slope = np.repeat([1.0, 1.0, 0.0], counts)
        self._counts = counts
        self._bound = np.repeat([0.0, spill or 0.0, 1.0], counts)
        self._even_bound = np.repeat([0.0, 0.0, 1.0], counts)

    def program(self, even: bool, options: Options | None) -> LinearProgram:
        """Return the program that minimizes off-target with a bound on spill. If ``even``, the
        program instead minimizes the larger of off-target and spill."""
        slope, bound = (self._even_slope, self._even_bound) if even else (self._slope, self._bound)
        return self._of(slope, bound, options)

    def least_spill(
        self, selective: LinearProgram, other: float, options: Options | None
    ) -> LinearProgram:
        """Return the solved program that minimizes spill with a bound on off-target."""
        slope = np.repeat([0.0, 1.0, 0.0], self._counts)
        bound = np.repeat([other, 0.0, 1.0], self._counts)
        program = self._of(slope, bound, options, selective)
        program.most_selective()
        if self.break_limits(program) and self.limit(program):
            program.most_selective()
        return program

    def _of(
        self,
        slope: Array,
        bound: Array,
        options: Options | None,
        after: LinearProgram | None = None,
    ) -> LinearProgram:
        size = self.orbits.sum(axis=0)
        array = self._problem.profile.electrodes
        # Break ties: prefer less current, then electrodes near the site, then near the middle.
        from_site = array.distance_mm[self._site] @ self.orbits
        from_middle = np.linalg.norm(array.position_mm, axis=1) @ self.orbits
        ties, peaks = (size, from_site, from_middle), _peaks(self._problem)
        return LinearProgram(
            self._rows, slope, bound, self._aims, size, ties, peaks, options, after
        )

    def limit(self, program: LinearProgram) -> bool:
        """Add the profile's current limits to a program; return False if there are none."""
        reference, factors, total = self._limits()
        if np.isinf(total) and np.isinf(factors).all():
            return False
        program.limit(reference, factors, None if np.isinf(total) else total)
        return True

    def break_limits(self, program: LinearProgram) -> bool:
        """Return True if a program's optimum exceeds the limits, or if other optima may exist."""
        pattern, (reference, factors, total) = program.pattern, self._limits()
        current, magnitude = float(reference @ pattern), np.abs(pattern)
        in_all = float(self.orbits.sum(axis=0) @ magnitude)
        return not (
            program.unique
            and current > 0
            and bool((magnitude <= factors * current).all())
            and in_all <= (total * current)
        )

    def _limits(self) -> tuple[Array, Array, float]:
        """Return the arguments of `LinearProgram.limit`. Limits are relative to the current of the
        site's electrode."""
        total, electrode = limits_ma(self._problem.profile)
        site, full = self._site, self._problem.full_ma(self._site)
        reference = np.sign(self._problem.target[site, site]) * self.orbits[site]
        factors = np.where(self.orbits > 0, electrode[:, None], np.inf).min(axis=0) / full
        # Do not limit the site's electrode: in a valid profile, its comfort level keeps the limits.
        factors[self.orbits[site].argmax()] = np.inf
        # `total` limits the cathodic current, which is half of the sum of magnitudes.
        return reference, factors, 2 * total / full


def _peaks(problem: Problem) -> Chooser:
    """Return a function that selects violated rows at local maxima of the excess. Other rows are
    not needed, because rows of neighboring nodes are nearly equal."""

    def choose(excess: Array) -> np.ndarray:
        chosen, start = [], 0
        for (high, wide), count in problem.grids:
            stop = start + count * high * wide
            hill = excess[start:stop].reshape(count, high, wide)
            if (hill > 1e-7).any():
                top = hill == maximum_filter(hill, size=(1, 3, 3), mode="constant", cval=-np.inf)
                chosen.append(start + np.flatnonzero(top & (hill > 1e-7)))
            start = stop
        loose = start + np.flatnonzero(excess[start:] > 1e-7)
        chosen.append(loose[np.argsort(excess[loose])[::-1][:_LOOSE_ROWS]])
        return np.concatenate(chosen)

    return choose
