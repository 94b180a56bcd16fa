"""Kernels that stay what they are where electrodes are masked, or currents limited otherwise.

A kernel that is the best of many patterns is the best of fewer, as long as it is among them.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.batch_design import Design
from smarttouch.kernels.design_problem import Array, Kernel, KernelKind, Problem, limits_ma
from smarttouch.profile import Profile

_NOTHING = 1e-9  # part of a kernel's strongest current that is a last bit of the solver's
_CLEAR = 1 - 1e-6


def kept_or(
    design: Design, before: Profile, known_kernel: Callable[[Afferent, int, KernelKind], Kernel]
) -> Design:
    """Return a design that gives a site its kernel of another profile where that stays the best:
    without current at masked electrodes, and either its limits are the same, or the kernel
    is within the limits and was not held up by those before."""

    def keep_or_design(problem: Problem, site: int) -> Kernel:
        known = known_kernel(problem.afferent, site, "weighted")
        weights, masked = known.weights.copy(), list(problem.profile.output.masked)
        peak = np.abs(weights).max()
        if (np.abs(weights[masked]) > _NOTHING * peak).any() or not (
            _same_limits(before, problem.profile, site)
            or (_within(weights, site, before) and _within(weights, site, problem.profile))
        ):
            return design(problem, site)
        weights[masked] = 0.0
        weights[problem.driven] -= weights[problem.driven].mean()
        return replace(known, weights=weights)

    return keep_or_design


def _same_limits(before: Profile, now: Profile, site: int) -> bool:
    (total, own), (total_now, own_now) = limits_ma(before), limits_ma(now)
    alike = total == total_now and np.array_equal(own, own_now)
    return alike and bool(before.full_ma[site] == now.full_ma[site])


def _within(weights: Array, site: int, profile: Profile) -> bool:
    """Return whether a pattern (E,) keeps clear of a profile's limits at a site's full current."""
    total, electrode = limits_ma(profile)
    if weights[site] == 0:
        return bool(np.isinf(total) and np.isinf(electrode).all())
    carried = np.abs(weights) * float(profile.full_ma[site]) / abs(weights[site])
    in_all, carried[site] = carried.sum() / 2, 0.0
    return bool(in_all <= _CLEAR * total and (carried <= _CLEAR * electrode).all())
