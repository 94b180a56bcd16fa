"""Kernels that do not disturb one another's targets, from precomputed matrices.

Side effects of currents w are a quadratic form wᵀMw, M the sum of the outer products of the AF
rows of all nodes of the own class, and of the squared currents. The currents that activate the
targets of a set of sites as wished, y, and cause the least of it, are

    w = P Tᵀ (T P Tᵀ)⁻¹ y

with T the AF rows of the targets and P the inverse of M on the driven electrodes with Σw = 0 (least
squares with linear constraints).
"""

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.frame_judges import FrameJudge

Array = NDArray[np.float64]

_SOFT = 1e-6
"""Part of the targets' mean response that keeps systems solvable if all sites are active."""
AIM = 0.8  # part of the allowed unevenness by which all targets are made weaker, to save current


class FrameOperator:
    """Solver for the kernels of sites that share slots."""

    def __init__(self, judge: FrameJudge) -> None:
        self.judge = judge
        driven, count = judge.profile.driven, len(judge.profile.electrodes)
        gram = judge.own.gram()
        form = np.eye(count) + gram / np.trace(gram) * count
        # Masked electrodes carry nothing, and all currents sum to zero.
        basis = _zero_sum(len(driven))
        inner = basis.T @ form[np.ix_(driven, driven)] @ basis
        inverse = np.zeros((count, count))
        inverse[np.ix_(driven, driven)] = basis @ np.linalg.inv(inner) @ basis.T
        self._columns = inverse @ judge.target.T
        self._response = judge.target @ self._columns
        self._soft = _SOFT * float(np.trace(self._response)) / len(self._response)

    def independent(self, sites: NDArray[np.intp]) -> Array:
        """Return kernels (A, E) mA per V/mm² of a set of sites that do not disturb one another."""
        system = self._response[np.ix_(sites, sites)] + self._soft * np.eye(len(sites))
        return np.asarray(np.linalg.solve(system, self._columns[:, sites].T))


def _zero_sum(count: int) -> Array:
    """Return an orthonormal basis of the vectors that sum to zero, (n, n − 1)."""
    full, _ = np.linalg.qr(np.c_[np.ones(count), np.eye(count)[:, 1:]])
    return np.asarray(full[:, 1:])
