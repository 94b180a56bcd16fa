"""Finished currents on every finger of the profile's spread, and from inexact boards."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.frame_fields import FrameFigures
from smarttouch.kernels.frame_judges import FrameJudge
from smarttouch.physiology.activating_function import (
    Afferents,
    depth_mm,
    flat_directions,
    tilted_directions,
)
from smarttouch.profile import Skin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Worst:
    """Worst figures over some variants; each may come from another one."""

    off_target: float
    spill: float
    weakest: float
    strongest: float

    @classmethod
    def of(cls, figures: Sequence[FrameFigures]) -> "Worst":
        return cls(
            max(each.off_target for each in figures),
            max(each.spill for each in figures),
            min(each.weakest for each in figures),
            max(each.strongest for each in figures),
        )


def spread_judges(
    judge: FrameJudge, part: float = 1.0, depth: bool = True, angle: bool = True
) -> list[FrameJudge]:
    """Return judges for every finger of a part of ``skin.spread``, in depth, direction or both.

    The own class is taken at each depth and in each direction by itself, as ratios are to it; of
    the other classes each depth is taken by itself, both classes shifted alike (the larger of the
    two counts, so other combinations say nothing new), and all directions together.
    """
    skin, afferent = judge.profile.skin, judge.afferent
    turn = skin.spread.angle_deg * part if angle else 0.0
    shifts = [0.0, 1.0, -1.0] if depth else [0.0]
    found = []
    for other_shift in shifts:
        others = None
        for own_shift in shifts:
            moved = _shifted(skin, afferent, own_shift * part, other_shift * part)
            for vary in _turns(afferent, turn):
                found.append(
                    FrameJudge(judge.profile, afferent, judge.wish_af, moved, vary, others)
                )
                others = found[-1].others
    return found


def with_gain_error(current: Array, part: float, draws: int, seed: int) -> Iterator[Array]:
    """Yield currents (E,) of a board whose channels have gain errors, normal with ``part``."""
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        yield current * (1 + part * rng.standard_normal(len(current)))


def uneven_levels(level: Array, part: float, seed: int) -> Array:
    """Return levels (E,) as for thresholds that differ by ± ``part`` between electrodes.

    The least sensitive site has its level, all others less.
    """
    rng = np.random.default_rng(seed)
    return np.asarray(level * rng.uniform(1 - part, 1 + part, len(level)) / (1 + part))


def _shifted(skin: Skin, afferent: Afferent, own: float, other: float) -> Skin:
    update = {}
    for each in Afferent:
        name = f"{each.name.lower()}_depth_mm"
        spread = getattr(skin.spread, name)
        update[name] = depth_mm(skin, each) + spread * (own if each is afferent else other)
    return skin.model_copy(update=update)


def _turns(afferent: Afferent, turn_deg: float) -> list[Callable[[Afferents], Afferents]]:
    """Return the rotations of afferents: the own class one way each, others all ways at once."""
    if turn_deg == 0:
        return [lambda one: one]

    def turned(one: Afferents, way: int) -> Afferents:
        upright = bool(one.direction[0, 2])
        if one.afferent is not afferent:
            way_all = [
                _turned(one.direction, turn_deg, each) for each in range(5 if upright else 3)
            ]
            return replace(one, direction=np.concatenate(way_all))
        return replace(one, direction=_turned(one.direction, turn_deg, way))

    ways = 5 if afferent is Afferent.RA else 3
    return [partial(turned, way=way) for way in range(ways)]


def _turned(direction: Array, turn_deg: float, way: int) -> Array:
    if direction[0, 2]:
        return tilted_directions(turn_deg)[way : way + 1]
    angles = np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
    return flat_directions(tuple(angles + (0.0, turn_deg, -turn_deg)[way]))
