"""Connected components of ink: letters, rules, and rows in which each letter is linked to the next,
but not across columns."""

from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

Ink = NDArray[np.bool_]
Indices = NDArray[np.int_]

_FEWEST_PIXELS, _LEAST_SIDE = 3, 3  # least area of a component, and least height of a letter
_LARGEST_PART = 0.25  # part of the page's shorter side above which a component is no letter
_DOT = 0.7  # filled part of its box above which a component is a dot
_RULE = 12.0  # ratio of length to thickness above which a component is a rule
_LETTER = (0.55, 9.0)  # range of letter heights on a page, relative to the usual one
_COMMA = (0.8, 0.5)  # largest height and width of a comma or a quote, in usual heights
_LONGEST = 40.0  # largest ratio of length to height of a word with touching letters
_UNDERLINE, _THIN, _HANGING = 3.0, 0.3, 0.2
"""Least length and most thickness of an underline, in letter heights; most ink right below it."""
_TWO_LINES, _LEAST_LINE, _BESIDE = 1.7, 0.6, 1.5
"""Height of a component that may span two lines, of a line, and reach beside it, in heights."""
_VALLEY = 0.4  # ink between two lines that touch, relative to that in either
_FILLED = 0.15  # least filled part of the box of a picture


@dataclass(frozen=True, eq=False)
class Components:
    """Boxes of connected components, (N,) px; right and bottom are the first outside."""

    left: NDArray[np.int_]
    top: NDArray[np.int_]
    right: NDArray[np.int_]
    bottom: NDArray[np.int_]
    area: NDArray[np.int_]

    @property
    def height(self) -> NDArray[np.int_]:
        """Heights, (N,) px."""
        return self.bottom - self.top

    @property
    def width(self) -> NDArray[np.int_]:
        """Widths, (N,) px."""
        return self.right - self.left

    @property
    def usual_height(self) -> float:
        """Median height, px, weighted by size so that dots count little."""
        order = np.argsort(self.height)
        weight = np.cumsum(np.sqrt(self.area[order]))
        return float(self.height[order][np.searchsorted(weight, weight[-1] / 2)])

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int_]) -> "Components":
        """Return some of the components."""
        return Components(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def joined(self, others: "Components") -> "Components":
        """Return these components and others."""
        sides = [(getattr(self, each.name), getattr(others, each.name)) for each in fields(self)]
        return Components(*map(np.concatenate, sides))


def find_components(ink: Ink) -> tuple[Components, NDArray[np.int32]]:
    """Return all components of an image of ink, (H, W), and their labels, from 1, (H, W)."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(ink.view(np.uint8), connectivity=8)
    left, top, width, height, area = boxes[1:].astype(np.int_).T
    found = Components(left, top, left + width, top + height, area)
    return found, np.asarray(labels, np.int32)


def without_specks(components: Components) -> Components:
    """Return the components that may be part of print."""
    return components.of(components.area >= _FEWEST_PIXELS)


def usual_height(components: Components, shape: tuple[int, int]) -> float | None:
    """Return the usual height of letters, px; None if no component may be one."""
    height, width = components.height, components.width
    kept = (height >= _LEAST_SIDE) & (height < _LARGEST_PART * min(shape))
    kept &= (width < _RULE * height) & (height < _RULE * width)
    # The dots of leaders may be more than the letters.
    kept &= (components.area < _DOT * width * height) | (height > 2 * width)
    return components.of(kept).usual_height if kept.any() else None


def like_letters(components: Components, height: float) -> NDArray[np.bool_]:
    """Return for each component, (N,), whether it may be a letter, or several that touch."""
    tall, wide = components.height, components.width
    right_size = (tall >= _LETTER[0] * height) & (tall <= _LETTER[1] * height)
    right_size &= (tall > _COMMA[0] * height) | (wide > _COMMA[1] * height)
    return np.asarray(right_size & (wide < _LONGEST * tall))


def are_pictures(components: Components, height: float) -> NDArray[np.bool_]:
    """Return for each component, (N,), whether it is large both ways, and filled."""
    large = np.minimum(components.width, components.height) > _LETTER[1] * height
    return np.asarray(
        large & (components.area > _FILLED * components.width * components.height), np.bool_
    )


def find_rules(ink: Ink, height: float) -> tuple[Ink, Ink]:
    """Return the ink of horizontal rules and underlines, and of vertical rules, (H, W) each."""
    page = ink.view(np.uint8)
    thick, long = max(3, round(_THIN * height)), round(_RULE * height)
    run = np.ones((1, round(_UNDERLINE * height)), np.uint8)
    rules = cv2.morphologyEx(page, cv2.MORPH_OPEN, run).view(np.bool_)
    runs, labels = find_components(rules)
    is_rule = runs.width > long
    for k in np.flatnonzero(~is_rule & (runs.height <= thick)):
        across, bottom = slice(runs.left[k], runs.right[k]), runs.bottom[k]
        # Letters hang from the line above them in some scripts.
        below = ink[bottom + 1 : bottom + 1 + thick, across]
        is_rule[k] = below.size and below.mean() < _HANGING
    rules = np.append(False, is_rule)[labels]
    # A slightly tilted rule steps sideways by a pixel.
    wide = cv2.dilate(page, np.ones((1, 3), np.uint8))
    upright = cv2.morphologyEx(wide, cv2.MORPH_OPEN, np.ones((long, 1), np.uint8))
    upright = np.asarray(cv2.min(upright, page), np.uint8)
    thicker = cv2.dilate(rules.view(np.uint8), np.ones((3, 1), np.uint8))
    return thicker.view(np.bool_), upright.view(np.bool_)


def part_lines(ink: Ink, components: Components, height: float) -> Ink:
    """Return the ink, (H, W), cut where letters of one line touch those of the next."""
    tall = (components.height > _TWO_LINES * height) & (components.height < _LETTER[1] * height)
    usual = components.of(like_letters(components, height) & ~tall)
    middle = (usual.top + usual.bottom) / 2
    parted = ink.copy() if tall.any() else ink
    for k in np.flatnonzero(tall):
        left, right = int(components.left[k]), int(components.right[k])
        top, bottom = int(components.top[k]), int(components.bottom[k])
        # A large letter has large letters beside it; two that touch have lines above and below.
        near = (usual.right > left - _BESIDE * height) & (usual.left < right + _BESIDE * height)
        near &= (middle > top) & (middle < bottom)
        upper = near & (middle < (top + bottom) / 2)
        sides = (usual.right[near] <= left).any() and (usual.left[near] >= right).any()
        one = not sides or not upper.any() or (upper == near).all()
        if one and right - left < bottom - top:
            continue
        least, parts = round(_LEAST_LINE * height), [(top, bottom)]
        while parts:
            first, last = parts.pop()
            if last - first <= _TWO_LINES * height:
                continue
            profile = ink[first:last, left:right].sum(axis=1)
            cut = least + int(profile[least:-least].argmin())
            if profile[cut] < _VALLEY * min(profile[:cut].max(), profile[cut:].max()):
                parted[first + cut, left:right] = False
                parts += [(first, first + cut), (first + cut + 1, last)]
    return parted


_NEIGHBORS = 10  # candidates for the next letter, near the right edge of a letter
_WIDEST_GAP = 3.8  # in heights of the taller letter: a dash or = between two spaces
_LEAST_OVERLAP = 0.45  # of two letters of a row, as a part of the lower one's height
_LARGEST_RATIO = 2.8  # of heights in a row: a parenthesis has 2.5 times the height of an x
_LEAST_SPACE = 0.35  # narrowest space, in letter heights; a narrower gap is within a word
_NARROWEST, _LANES = 0.75, ((1.25, 15.0), (1.9, 8.0))
"""Least width of the white between columns, in letter heights, and in usual spaces if it is so
many letter heights long."""
_LANE_REACH, _SHORT_LINES = 16.0, 6.5
"""Farthest print on both sides of a lane, and height of short lines among it, in letter heights."""


def find_rows(letters: Components, ink: Ink, walls: Ink, height: float) -> list[Indices]:
    """Return the indices of the letters of each row, from left to right.

    Rows end at ``walls``, (H, W), which are vertical rules and pictures, and at white lanes in
    ``ink``, (H, W), between columns.
    """
    if len(letters.area) < 2:
        return [np.arange(1)] * len(letters.area)
    first, second, gap = _link_neighbors(letters)
    spaces = gap[gap > _LEAST_SPACE * letters.height[first]]
    lanes = _lanes(ink, height, float(np.median(spaces)) if len(spaces) else 0.0)
    middle = (letters.top[first] + letters.bottom[first]) // 2
    ends = np.minimum(letters.left[second], ink.shape[1] - 1)
    passed = (np.cumsum(mask, axis=1, dtype=np.int32) for mask in (walls, lanes))
    walled, laned = (x[middle, ends] > x[middle, letters.right[first] - 1] for x in passed)
    # Letters of a headline are farther apart than columns.
    wide = 2 * gap > _NARROWEST * (letters.height[first] + letters.height[second])
    free = ~(walled | (laned & wide))
    following = dict(zip(first[free].tolist(), second[free].tolist(), strict=True))
    rows = []
    for start in sorted(set(range(len(letters.area))) - set(following.values())):
        row = [start]
        while row[-1] in following:
            row.append(following[row[-1]])
        rows.append(np.array(row))
    return rows


def _lanes(ink: Ink, height: float, space: float) -> Ink:
    """Return the tall white between print on both sides, (H, W)."""
    page = ink.view(np.uint8)
    beside = np.ones((1, round(_LANE_REACH * height)), np.uint8)
    leading = np.ones((round(_SHORT_LINES * height) | 1, 1), np.uint8)
    white = ~ink
    for x in (0, beside.size - 1):
        near = cv2.dilate(page, beside, anchor=(x, 0))
        white &= cv2.morphologyEx(near, cv2.MORPH_CLOSE, leading) > 0
    found = np.zeros_like(ink)
    for spaces, length in _LANES:
        width = max(3, round(max(_NARROWEST * height, spaces * space)))
        lane = np.ones((round(length * height), width), np.uint8)
        found |= cv2.morphologyEx(white.view(np.uint8), cv2.MORPH_OPEN, lane) > 0
    return found


def _link_neighbors(letters: Components) -> tuple[Indices, Indices, Indices]:
    """Return links from letters to the next ones on their right, where both agree: (L,) indices of
    both, and the white between, px."""
    from scipy.spatial import cKDTree

    height, middle = letters.height, (letters.top + letters.bottom) / 2
    # Vertical distance counts twice.
    tree = cKDTree(np.column_stack([letters.left, 2 * middle]))
    near = min(_NEIGHBORS, len(height) - 1) + 1
    reach = 2 * _WIDEST_GAP * float(height.max())
    ends = np.column_stack([letters.right, 2 * middle])
    _, found = tree.query(ends, k=near, distance_upper_bound=reach)
    first, second = np.repeat(np.arange(len(height)), near), found.ravel()
    first, second = first[second < len(height)], second[second < len(height)]
    one, other = letters.of(first), letters.of(second)
    taller = np.maximum(one.height, other.height)
    lower = np.minimum(one.height, other.height)
    gap = other.left - one.right
    beside = np.minimum(one.bottom, other.bottom) - np.maximum(one.top, other.top)
    kept = (gap <= _WIDEST_GAP * taller) & (other.left + other.right > one.left + one.right)
    kept &= (beside >= _LEAST_OVERLAP * lower) & (taller <= _LARGEST_RATIO * lower)
    # A pixel of vertical offset costs as much as a pixel of gap.
    cost = (np.maximum(gap, 0) + lower - beside)[kept]
    cheapest = np.argsort(cost, kind="stable")
    first, second, gap = (each[kept][cheapest] for each in (first, second, gap))
    follows, precedes = (np.unique(each, return_index=True)[1] for each in (first, second))
    agreed = np.intersect1d(follows, precedes)
    return first[agreed], second[agreed], gap[agreed]
