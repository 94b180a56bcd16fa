"""Kernels of a profile with ``kernels.objective = "finger"``."""

import time
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.batch_design import Timed, keep_kernel, kept_kernel
from smarttouch.kernels.design_problem import Kernel, Problem
from smarttouch.kernels.finger_design import FingerDesign, FingerSample
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile

FIRST_SEED = 10_001
"""Seed of the first finger of a design: those from 1 on are left to judge it."""


class FingerKernels:
    """Designer of a profile's kernels on the fingers that its table ``kernels`` names.

    ``at_nodes`` returns the kernels of a class with which it begins, designed at nodes: (E, E)
    parts of the full current.
    """

    def __init__(
        self, profile: Profile, at_nodes: Callable[[Afferent], NDArray[np.float32]]
    ) -> None:
        self.profile: Profile = profile
        self._at_nodes = at_nodes
        self.anatomies: list[Anatomy] = [load_anatomy(one) for one in profile.kernels.anatomy]
        self._problems: dict[Afferent, Problem] = {}

    def problem(self, afferent: Afferent) -> Problem:
        """Return the design problem of a class on nodes."""
        if afferent not in self._problems:
            self._problems[afferent] = Problem(self.profile, afferent)
        return self._problems[afferent]

    def kernels(
        self,
        afferent: Afferent,
        sites: Sequence[int],
        progress: Callable[[int, int], None] | None = None,
        keep: Path | None = None,
    ) -> list[Timed]:
        """Return kernels, as fractions of full current, and the seconds that each took.

        Finished classes are stored in the folder `keep` and read from there.
        """
        problem = self.problem(afferent)
        for site in sites:
            problem.check_site(site)
        found = [kept_kernel(keep, problem, site) for site in sites]
        if not all(found):
            found = [*self._designed(problem, np.array(sites, np.intp), progress)]
            for site, each in zip(sites, found, strict=True):
                if keep is not None and each is not None:
                    keep_kernel(keep, problem, site, *each)
        return [each for each in found if each is not None]

    def _designed(
        self, problem: Problem, sites: NDArray[np.intp], progress: Callable[[int, int], None] | None
    ) -> list[Timed]:
        began = time.perf_counter()
        design = FingerDesign(
            self.profile, problem.afferent, self._sample, self._start_ma(problem.afferent),
            self._mirror(problem),
        )  # fmt: skip
        current_ma = design.designed(sites, progress)
        figures = design.figures(sites)
        seconds = (time.perf_counter() - began) / len(sites)
        return [
            (Kernel(weights, float(wrong), Afferent(int(worst)), float(elsewhere)), seconds)
            for weights, wrong, elsewhere, worst in zip(
                current_ma / self.profile.full_ma[sites, None], *figures, strict=True
            )
        ]

    @cached_property
    def _sample(self) -> FingerSample:
        fingers = [
            Finger(self.profile, FIRST_SEED + index, self.anatomies[index % len(self.anatomies)])
            for index in range(self.profile.kernels.fingers)
        ]
        most_ma = max(np.abs(self._start_ma(each)).sum(axis=1).max() for each in Afferent) / 2
        return FingerSample.of(fingers, float(self.profile.full_ma.max()), float(most_ma))

    def _start_ma(self, afferent: Afferent) -> NDArray[np.float64]:
        return np.asarray(self._at_nodes(afferent) * self.profile.full_ma[:, None])

    def _mirror(self, problem: Problem) -> NDArray[np.intp] | None:
        """Return the permutation that swaps left and right, or None without that symmetry."""
        if any(one.of(each).flat_deg % 180 != 90 for one in self.anatomies for each in Afferent):
            return None
        place_mm = problem.profile.electrodes.position_mm
        for move in problem.symmetries:
            if np.allclose(place_mm[move], place_mm * [-1, 1], atol=1e-6):
                return move
        return None
