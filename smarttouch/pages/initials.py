"""Initials: large letters over several lines, which belong to the first word beside them."""

import numpy as np

from smarttouch.pages.baselines import Baseline, Floats, between
from smarttouch.pages.spots import Spots

_HEIGHT, _NARROW, _WIDE, _SOLID = (2.8, 16.0), 0.22, 1.6, 0.85
"""Its height in x-heights, its width in heights, and most part of its box that it fills."""
_FEWEST, _BESIDE = 2, (-0.8, 3.0)
"""Fewest lines beside it, and how far from it they begin, in x-heights."""
CAPITAL = 1.45  # height of a capital, in x-heights
_TOP, _FOOT = 1.0, (-0.7, 1.6)
"""Offset of its top from that of the first line, and range of its foot below the last baseline."""
_BELOW, _ALIGNED = 4.5, 1.3
"""Farthest line below it, and offset of that line's begin from its left, in x-heights."""
_CLEAR = 2.0  # white on its left, in x-heights


def part_initials(baselines: list[Baseline], spots: Spots) -> tuple[list[Baseline], dict[int, int]]:
    """Return lines without the initials in them, and by line the index of its initial's spot."""
    if not baselines:
        return [], {}
    size = float(np.median([each.x_height for each in baselines]))
    tall = (spots.height > _HEIGHT[0] * size) & (spots.height < _HEIGHT[1] * size)
    tall &= (spots.width > _NARROW * spots.height) & (spots.width < _WIDE * spots.height)
    tall &= spots.area < _SOLID * spots.width * spots.height
    found: dict[int, int] = {}
    lines: list[Baseline | None] = list(baselines)
    for spot in np.flatnonzero(tall).tolist():
        left, right = float(spots.left[spot]), float(spots.right[spot])
        top, bottom = float(spots.top[spot]), float(spots.bottom[spot])
        first = _first_line(baselines, (left, top, right, bottom))
        if first is None or first in found:
            continue
        found[first] = spot
        for k, line in enumerate(baselines):
            if not top < line.middle_y < bottom + _FOOT[1] * line.x_height:
                continue
            if left - 1 <= line.left < right and line.right > right + line.x_height:
                lines[k] = between(line, right, line.right)
            elif left - line.x_height < line.left and line.right < right + line.x_height:
                lines[k] = None
    kept = [k for k, line in enumerate(lines) if line is not None]
    place = {k: new for new, k in enumerate(kept)}
    return (
        [line for line in lines if line is not None],
        {place[k]: spot for k, spot in found.items() if k in place},
    )


def _first_line(baselines: list[Baseline], box: tuple[float, float, float, float]) -> int | None:
    """Return the index of the first of the lines beside a letter, left, top, right, bottom, px, if
    it is an initial."""
    left, top, right, bottom = box
    beside: list[int] = []
    continued = False
    for k, line in enumerate(baselines):
        x = line.x_height
        begin = right if left - 1 <= line.left < right else line.left
        base = line.y_at(begin)
        if base - x > top - x and base < bottom + _FOOT[1] * x:
            if line.right > right + x and _BESIDE[0] * x < begin - right < _BESIDE[1] * x:
                beside.append(k)
            elif line.left < left and left - line.right < _CLEAR * x:
                return None
        elif 0 < base - bottom < _BELOW * x:
            continued |= abs(line.left - left) < _ALIGNED * x
    if len(beside) < _FEWEST or not continued:
        return None
    bases: Floats = np.array([baselines[k].y_at(right) for k in beside])
    x = float(np.median([baselines[k].x_height for k in beside]))
    foot = bottom - bases.max()
    high = abs(bases.min() - CAPITAL * x - top)
    if high > _TOP * x or not _FOOT[0] * x < foot < _FOOT[1] * x:
        return None
    return beside[int(bases.argmin())]
