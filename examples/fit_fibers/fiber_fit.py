"""Driving functions fitted to the thresholds of a cable model.

The fit starts from what the membrane would do if it were linear, which is within a tenth or
so, and minimizes the errors of the thresholds' logarithms.
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

_OWN_NODES = 4
_BLOCKS = (np.inf, 4.0, 2.8, 2.0, 1.4)
_WELL = 0.03
"""Error up to which no block is looked for."""
_WORTHWHILE = 0.8
"""Part of the error to which a block has to bring it down."""
_TOLERANCE = 0.05
"""Error up to which squares count; beyond it they grow more slowly (soft L1)."""
_TIED = 0.1
"""Error that counts as much as a weight that is off its start by all of itself: what cases do not
decide stays as the membrane would have it if it were linear."""
_LEAST = 0.1
"""Drive at threshold below which the logarithm goes on as a straight line."""
_NODES = 60


def thresholds_ma(
    potential_mv: Array, fiber: Fiber, width_us: float, step_us: float = 4.0
) -> Array:
    """Return the cathodic thresholds (C,), mA, in fields (C, N); NaN where nothing fires."""
    found = np.full(len(potential_mv), np.nan)
    for index, each in enumerate(potential_mv):
        with contextlib.suppress(DesignError):
            found[index] = threshold_ma(each, fiber, width_us, cathodic=True, step_us=step_us)
    return found


def fit(
    fiber: Fiber, width_us: float, potential_mv: Array, threshold_ma: Array, reach: int = 8
) -> DrivingFunction:
    """Return the driving function that best gives thresholds.

    Parameters
    ----------
    fiber : Fiber
        Fiber of our own cable model, or the one most like it: the fit starts from it.
    width_us : float, µs
        Pulse width.
    potential_mv : ndarray, (C, N), mV per mA
        Potential at the nodes in C cases, ending first.
    threshold_ma : ndarray, (C,), mA
        Their thresholds; those that are not finite do not count.
    reach : int
        Neighbors of a node, to either side, that count.
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
        if least < _WELL:
            break
    assert best is not None
    return best


def _weights(features: Array, threshold_ma: Array, start: Array, block: float) -> Array:
    """Return the weights that best give thresholds, near those to start from."""
    every = np.arange(len(features))
    scale = np.abs(start) + 0.01 * np.abs(start).max()

    def fires(weights: Array) -> tuple[NDArray[np.intp], Array]:
        drive = features @ weights
        node = np.where(passes(drive, block), drive, drive.min() - 1).argmax(axis=1)
        return node, drive[every, node]

    def errors(weights: Array) -> Array:
        reached = threshold_ma * fires(weights)[1]
        straight = reached / _LEAST - 1 + np.log(_LEAST)
        missed = np.where(reached > _LEAST, np.log(np.maximum(reached, _LEAST)), straight)
        return np.concatenate([missed, _TIED * (weights - start) / scale])

    def slopes(weights: Array) -> Array:
        node, highest = fires(weights)
        steep = 1 / np.maximum(highest, _LEAST / threshold_ma)
        return np.vstack([features[every, node] * steep[:, None], np.diag(_TIED / scale)])

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
    """Return what the weights of each node multiply, (C, M, weights)."""
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
    """Return the weights of a fiber whose membrane only leaks."""
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
    """Errors of predicted thresholds, as factors above 1: 0.05 is five per cent either way.

    Attributes
    ----------
    cases : int
        Number of cases that fire.
    median, tenth, worst : float
        Half of the errors are below the first, nine tenths below the second.
    """

    cases: int
    median: float
    tenth: float
    worst: float


def threshold_error(drive: Array, threshold_ma: Array) -> ThresholdError:
    """Return the errors of the thresholds that drives predict.

    Parameters
    ----------
    drive : ndarray, (C,)
        Largest drive along each fiber for 1 mA.
    threshold_ma : ndarray, (C,), mA
        True thresholds; those that are not finite do not count.
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
    """Return the activating function alone, with the threshold that suits these cases best."""
    bends = potential_mv @ bend_operator(fiber.end, potential_mv.shape[1]).T
    highest = np.maximum(bends[:, int(fiber.end == "passive") :].max(axis=1), 1e-9)
    weight = 1 / np.exp(np.nanmedian(np.log(highest * threshold_ma)))
    return DrivingFunction(fiber.internode_mm, fiber.end, np.array([weight]), np.zeros((0, 0)))
