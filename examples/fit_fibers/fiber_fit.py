"""Fit of driving functions to thresholds of a cable model.

The fit starts from the weights of a linear membrane, whose thresholds are within about 10 % of the
cable model's. It minimizes the errors of the logarithms of thresholds.
"""

import contextlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares

from smarttouch.base.errors import DesignError
from smarttouch.physiology.membrane import (
    Axon,
    DrivingFunction,
    Fiber,
    bend_operator,
    passes,
    threshold_ma,
)

Array = NDArray[np.float64]

_OWN_NODES = 4  # number of nodes near an ending that have weights of their own
_BLOCKS = (np.inf, 4.0, 2.8, 2.0, 1.4)  # values of `DrivingFunction.block` to try, in this order
_GOOD_ERROR = 0.03
"""Error below which no further values of `_BLOCKS` are tried."""
_WORTHWHILE = 0.8
"""A value of `_BLOCKS` replaces the best value so far only if its error is less than this share of
the error of that value."""
_TOLERANCE = 0.05
"""Error up to which the soft L1 loss is nearly quadratic; for larger errors it is nearly linear."""
_STIFFNESS = 0.1
"""Threshold error that costs as much as a change of one weight by 100 %. Changes have a cost so
that a weight which the cases do not determine stays near that of a linear membrane."""
_LINEAR_BELOW = 0.1
"""At threshold, the drive should be 1, and the error is the logarithm of the drive. If the drive is
below this value, a line replaces the logarithm."""
_NODES = 60  # number of nodes of the linear cable


def thresholds_ma(
    potential_mv: Array, fiber: Fiber, width_us: float, step_us: float = 4.0
) -> Array:
    """Return the cathodic threshold of each case, (C,) mA; NaN if the fiber never fires."""
    found = np.full(len(potential_mv), np.nan)
    for index, each in enumerate(potential_mv):
        with contextlib.suppress(DesignError):
            found[index] = threshold_ma(each, fiber, width_us, cathodic=True, step_us=step_us)
    return found


def fit(
    fiber: Fiber, width_us: float, potential_mv: Array, threshold_ma: Array, reach: int = 8
) -> DrivingFunction:
    """Return the driving function that predicts thresholds with the smallest error.

    Parameters
    ----------
    fiber : Fiber
        The fit starts from the weights of this fiber with a linear membrane.
    width_us : float, µs
        Pulse width.
    potential_mv : ndarray, (C, N), mV per mA
        Potentials at the nodes in C cases. If the fiber has an ending, its node is the first.
    threshold_ma : ndarray, (C,), mA
        Threshold of each case; cases without a finite threshold are ignored.
    reach : int
        Number of neighbors on each side of a node that influence its drive.
    """
    counts = np.isfinite(threshold_ma)
    potential_mv, threshold_ma = potential_mv[counts], threshold_ma[counts]
    features = _features(fiber, potential_mv, reach)
    start = _linear_start(fiber, width_us, reach)
    start /= np.median(threshold_ma * (features @ start).max(axis=1))
    best, least = None, np.inf
    for block in _BLOCKS:
        found = _weights(features, threshold_ma, start, block)
        near_end = found[reach + 1 :].reshape(-1, reach + _OWN_NODES)
        driving = DrivingFunction(
            fiber.internode_mm, fiber.end, found[: reach + 1], near_end, block
        )
        error = threshold_error(driving.highest(potential_mv), threshold_ma).tenth
        if best is None or error < _WORTHWHILE * least:
            best, least = driving, error
        if least < _GOOD_ERROR:
            break
    assert best is not None
    return best


def _weights(features: Array, threshold_ma: Array, start: Array, block: float) -> Array:
    """Return the weights with the smallest errors, with a penalty on changes from ``start``."""
    every = np.arange(len(features))
    scale = np.abs(start) + 0.01 * np.abs(start).max()

    def fires(weights: Array) -> tuple[NDArray[np.intp], Array]:
        drive = features @ weights
        node = np.where(passes(drive, block), drive, drive.min() - 1).argmax(axis=1)
        return node, drive[every, node]

    def errors(weights: Array) -> Array:
        reached = threshold_ma * fires(weights)[1]
        line = reached / _LINEAR_BELOW - 1 + np.log(_LINEAR_BELOW)
        logarithm = np.log(np.maximum(reached, _LINEAR_BELOW))
        missed = np.where(reached > _LINEAR_BELOW, logarithm, line)
        return np.concatenate([missed, _STIFFNESS * (weights - start) / scale])

    def slopes(weights: Array) -> Array:
        node, highest = fires(weights)
        steep = 1 / np.maximum(highest, _LINEAR_BELOW / threshold_ma)
        return np.vstack([features[every, node] * steep[:, None], np.diag(_STIFFNESS / scale)])

    return np.asarray(
        least_squares(
            errors,
            start,
            slopes,
            x_scale=scale,
            loss="soft_l1",
            f_scale=_TOLERANCE,
            max_nfev=200,
        ).x
    )


def _features(fiber: Fiber, potential_mv: Array, reach: int) -> Array:
    """Return second differences, (C, M, W). Their weighted sum is the drive of each of M nodes."""
    bends = potential_mv @ bend_operator(fiber.end, potential_mv.shape[1]).T
    count, size = bends.shape
    padded = np.pad(bends, ((0, 0), (reach, reach)))
    sums = [bends] + [
        padded[:, reach - away :][:, :size] + padded[:, reach + away :][:, :size]
        for away in range(1, reach + 1)
    ]
    along = np.stack(sums, axis=-1)
    if fiber.end == "through":
        return along
    along = along[:, _OWN_NODES + (fiber.end == "passive") :]
    wide = reach + _OWN_NODES
    features = np.zeros((count, along.shape[1] + _OWN_NODES, reach + 1 + _OWN_NODES * wide))
    features[:, _OWN_NODES:, : reach + 1] = along
    for node in range(_OWN_NODES):
        own = reach + 1 + node * wide
        features[:, node, own : own + wide] = bends[:, :wide]
    return features


def _linear_start(fiber: Fiber, width_us: float, reach: int) -> Array:
    """Return the weights of a fiber with a linear membrane, which has only leak conductance."""
    axial, leak = Axon.passive_parts(fiber, _NODES)
    rates = axial[:, :_NODES] - np.diag(leak)
    answer = np.linalg.solve(rates, (expm(rates * width_us) - np.eye(_NODES)) @ axial[:, _NODES:])
    middle = _NODES // 2
    along = answer[middle, middle : middle + reach + 1]
    if fiber.end == "through":
        return np.asarray(along)
    first = int(fiber.end == "passive")
    return np.concatenate([along, answer[first:, : reach + _OWN_NODES][:_OWN_NODES].ravel()])


@dataclass(frozen=True)
class ThresholdError:
    """Relative errors of predicted thresholds: 0.05 means a factor of 1.05 too high or too low."""

    cases: int  # number of cases with a finite threshold
    median: float
    tenth: float  # 90 % quantile
    worst: float  # maximum


def threshold_error(drive: Array, threshold_ma: Array) -> ThresholdError:
    """Return the errors of thresholds that are predicted from drives.

    Parameters
    ----------
    drive : ndarray, (C,)
        Largest drive along each fiber at 1 mA.
    threshold_ma : ndarray, (C,), mA
        Thresholds of the cable model; cases without a finite threshold are ignored.
    """
    counts = np.isfinite(threshold_ma)
    predicted = np.maximum(drive[counts] * threshold_ma[counts], 1e-3)
    factor = np.exp(np.abs(np.log(predicted))) - 1
    return ThresholdError(
        int(counts.sum()),
        float(np.median(factor)),
        float(np.quantile(factor, 0.9)),
        float(factor.max()),
    )


def activating(fiber: Fiber, potential_mv: Array, threshold_ma: Array) -> DrivingFunction:
    """Return the activating function, scaled so that the median error of thresholds is zero."""
    bends = potential_mv @ bend_operator(fiber.end, potential_mv.shape[1]).T
    highest = np.maximum(bends[:, int(fiber.end == "passive") :].max(axis=1), 1e-9)
    weight = 1 / np.exp(np.nanmedian(np.log(highest * threshold_ma)))
    return DrivingFunction(fiber.internode_mm, fiber.end, np.array([weight]), np.zeros((0, 0)))
