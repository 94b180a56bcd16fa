"""Assignment of a frame's points to few slots, each within its bounds."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.kernels.frame_fields import FrameBounds, FrameFigures
from smarttouch.kernels.frame_operator import FrameOperator, keeps

Array = NDArray[np.float64]

_TRIES = 5  # slots to try for a point
_ROOM = 0.8  # part of the total current above which a slot is full


@dataclass(frozen=True, eq=False)
class FrameSlot:
    """One slot and its figures."""

    # (A,) points that it activates; of two classes E is added for the second class
    sites: NDArray[np.intp]
    current: Array  # (E,) mA at intensity 1, positive cathodic
    figures: FrameFigures
    kept: bool  # whether the bounds hold: always with several points, not always with one


def plan_slots(
    operator: FrameOperator,
    level: Array,
    bounds: FrameBounds,
    total_ma: float | None = None,
    points_ma: Array | None = None,
) -> list[FrameSlot]:
    """Return few slots that together activate every point with a level above zero, (P,) in [0, 1].

    The total current gives the number of slots to try first; points are dealt out so that those of
    one slot lie far apart. Points of slots that break a bound are dealt again to one slot more,
    down to single points, as long as it is current that is short, or no slot keeps its bounds.
    Where some do, and selectivity is short, each of the others' points joins a slot that then still
    keeps them, the farthest first, or has one of its own. A single point that breaks a bound even
    so takes its row of `points_ma`, (P, E) at level 1: the profile's own kernels at full current.
    """
    judge = operator.judge
    limit = judge.profile.limits.total_ma if total_ma is None else total_ma

    def slot_of(points: NDArray[np.intp]) -> FrameSlot:
        return _slot(operator, level, points, bounds, limit, points_ma)

    waiting = np.flatnonzero(level)
    done: list[FrameSlot] = []
    many = likely_slots(operator, level, bounds, limit)
    while len(waiting):
        failed: list[FrameSlot] = []
        for points in _dealt(judge.profile.electrodes.position_mm, waiting, many):
            slot = slot_of(points)
            (done if slot.kept or len(points) == 1 else failed).append(slot)
        waiting = np.concatenate([waiting[:0], *(slot.sites for slot in failed)])
        too_strong = sum(limit is not None and slot.figures.total_ma > limit for slot in failed)
        if 2 * too_strong <= len(failed) < many:
            break
        many = len(failed) + 1 + len(failed) // 4
    for point in waiting:
        _join(point, done, judge.profile.electrodes.position_mm, limit, slot_of)
    return done


def _join(
    point: np.intp,
    slots: list[FrameSlot],
    position_mm: Array,
    total_ma: float | None,
    slot_of: Callable[[NDArray[np.intp]], FrameSlot],
) -> None:
    """Add a point to one of the slots, or as a slot of its own."""
    count, tries = len(position_mm), 0
    near = [
        (_push(position_mm[slot.sites % count] - position_mm[point % count])).sum()
        for slot in slots
    ]
    for index in np.argsort(near, kind="stable").tolist():
        slot = slots[index]
        full = total_ma is not None and slot.figures.total_ma > _ROOM * total_ma
        if full or not slot.kept:
            continue
        joined = slot_of(np.sort(np.append(slot.sites, point)))
        if joined.kept:
            slots[index] = joined
            return
        tries += 1
        if tries == _TRIES:
            break
    slots.append(slot_of(np.array([point])))


def likely_slots(
    operator: FrameOperator, level: Array, bounds: FrameBounds, total_ma: float | None
) -> int:
    """Return the approximate number of slots by total current, with which a plan begins.

    Each point is taken to need what its own electrode alone would, weakened as far as the bounds
    allow. Returns cost a little more, neighbors save a little.
    """
    sites = np.flatnonzero(level)
    if not len(sites) or total_ma is None:
        return min(len(sites), 1)
    target = operator.judge.target
    own = target[sites, sites % target.shape[1]]
    needed_ma = (1 - bounds.uneven) * level[sites] * operator.judge.wish_af[sites] / own
    # Points of opposite polarity are each other's return.
    pole_ma = max(needed_ma[needed_ma > 0].sum(), -needed_ma[needed_ma < 0].sum())
    return max(1, int(np.ceil(pole_ma / total_ma - 1e-9)))


def _slot(
    operator: FrameOperator,
    level: Array,
    sites: NDArray[np.intp],
    bounds: FrameBounds,
    total_ma: float | None,
    points_ma: Array | None,
) -> FrameSlot:
    wanted = np.zeros_like(level)
    wanted[sites] = level[sites]
    try:
        current, figures = operator.bounded(wanted, bounds, total_ma)
    except np.linalg.LinAlgError:
        message = "the points of a slot depend on one another: give fewer"
        raise DesignError(message, about="slot") from None
    kept = keeps(operator.judge, figures, bounds, current, total_ma)
    if not kept and len(sites) == 1 and points_ma is not None:
        current = points_ma[sites[0]] * level[sites[0]]
        figures = operator.judge.judge(current, wanted)
        kept = keeps(operator.judge, figures, bounds, current, total_ma)
    return FrameSlot(sites, current, figures, kept)


def _dealt(position_mm: Array, sites: NDArray[np.intp], many: int) -> list[NDArray[np.intp]]:
    """Return sites in a number of groups, each group's sites far apart from one another."""
    many = min(many, len(sites))
    place, kind = position_mm[sites % len(position_mm)], sites // len(position_mm)
    apart = np.hypot(*(place[:, None] - place[None]).transpose(2, 0, 1))
    # Of each class about equally many: points of two classes may be each other's return.
    size, kinds = np.ceil(np.bincount(kind) / many).tolist(), kind.tolist()
    # The most crowded first: they have the fewest choices.
    crowd = (1 / (1 + apart**2)).sum(axis=1)
    groups: list[list[int]] = [[] for _ in range(many)]
    push, pushes = np.zeros((many, len(sites))), _push(place[:, None] - place[None])
    count = [[0] * many for _ in size]
    # By themselves a handful of numbers are quicker than an array of them.
    for each in np.argsort(-crowd, kind="stable").tolist():
        taken, most = count[kinds[each]], size[kinds[each]]
        pushed = [
            value + 1e9 * (has >= most)
            for value, has in zip(push[:, each].tolist(), taken, strict=True)
        ]
        chosen = pushed.index(min(pushed))
        groups[chosen].append(each)
        push[chosen] += pushes[each]
        taken[chosen] += 1
    return [np.sort(sites[group]) for group in groups if group]


def _push(between_mm: Array) -> Array:
    """Return the mutual disturbance of points at a distance, (..., 2) mm."""
    return np.asarray(1 / (1e-9 + np.hypot(between_mm[..., 0], between_mm[..., 1]) ** 3))
