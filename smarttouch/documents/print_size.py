"""Size of print, common to all lines of one print, whichever letters they have."""

import numpy as np

from smarttouch.documents.baselines import Baseline, Floats

ASCENT, DESCENT = 1.5, 0.45
"""Usual heights of a b above and of a p below the baseline, in x-heights."""
_SAME = 0.15  # difference of x-heights that may be a measurement error
_NEAREST = 9  # number of neighboring lines with which a line shares its x-height
_LOW_EDGE = 0.12  # ink at the end of the ascenders, relative to their middle
_FEWEST = 0.03
"""Least ink of ascenders or descenders, relative to the line, by which they are measured."""
_FARTHER = 1.2
"""Ratio by which tall letters reach beyond the usual ascenders, and are those of other scripts."""
_CAPITALS = 0.08
"""Ink above its letters below which a line has no ascenders: it is capitals or figures."""


def reach_of_print(baselines: list[Baseline]) -> tuple[float, float]:
    """Return the reach of ascenders and descenders from the baseline, in x-heights.

    It is measured over all lines of a page: few single ones have enough of either.
    """
    length = np.array([(each.right - each.left) / each.x_height for each in baselines])
    height = np.arange(-1.0, 2.2, 0.02)
    profiles = [np.interp(height, each.heights[::-1], each.profile[::-1]) for each in baselines]
    ink = np.average(profiles, axis=0, weights=length)
    zone = ink[(height > 0.05) & (height < 0.95)].mean()
    ascent = _end(height, ink, (1.2, 1.35), zone)
    descent = _end(-height[::-1], ink[::-1], (0.15, 0.3), zone)
    reach = np.array([each.reach for each in baselines]).T
    tall, deep = (_weighted_median(each, length) for each in reach)
    # Other scripts reach farther, with ink at any height.
    ascent, descent = ascent or ASCENT, descent or DESCENT
    return (
        tall if tall > _FARTHER * ascent else ascent,
        deep if deep > _FARTHER * descent + _SAME else descent,
    )


def _end(height: Floats, ink: Floats, middle: tuple[float, float], zone: float) -> float | None:
    """Return where ink ends outward from some height."""
    there = float(ink[(height >= middle[0]) & (height <= middle[1])].mean())
    if there < _FEWEST * zone:
        return None
    outside = (height > middle[1]) & (ink < _LOW_EDGE * there)
    return float(height[outside][0]) if outside.any() else None


def shared_x_heights(baselines: list[Baseline], ascent: float) -> Floats:
    """Return the x-height of each line, shared with neighbors of the same print, (N,) px.

    Lines of capitals and figures measure taller: they get the x-height of their print.
    """
    size = np.array([baseline.x_height for baseline in baselines])
    length = np.array([baseline.right - baseline.left for baseline in baselines])
    y = np.array([baseline.middle_y for baseline in baselines])
    above = np.array(
        [
            baseline.ink_between(1.1, 1.4) / baseline.ink_between(0.05, 0.95)
            for baseline in baselines
        ]
    )
    most = _weighted_median(size, length)
    capitals = (above < _CAPITALS) & (np.abs(size / most / ascent - 1) < _SAME)
    size = np.where(capitals, size / ascent, size)
    shared = np.empty_like(size)
    for k in range(len(size)):
        near = np.flatnonzero(np.abs(size / size[k] - 1) < _SAME)
        near = near[np.argsort(np.abs(y[near] - y[k]))][:_NEAREST]
        shared[k] = _weighted_median(size[near], length[near])
    return shared


def _weighted_median(values: Floats, weight: Floats) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])
