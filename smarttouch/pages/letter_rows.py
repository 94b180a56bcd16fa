"""Rows of letters. Connected components of ink are linked from left to right. The heights and the
strokes of a row show whether the row is text. Lanes are the white gaps between columns."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.pages.page_and_lines import curve_at

Floats = NDArray[np.float64]
Ink = NDArray[np.bool_]
Indices = NDArray[np.int_]

_LEAST_SIDE = 3  # smallest height of a letter, px
_LARGEST_PART = 0.25  # largest height of a letter, relative to the page's shorter side
_DOT = 0.7  # smallest share of ink in the box of a dot
_RULE = 12.0  # ratio of length to thickness above which a component is a rule
_LETTER = (0.55, 9.0)  # range of letter heights on a page, relative to the typical height
_COMMA = (0.8, 0.5)  # largest height and width of a comma or quote, in typical letter heights
_LONGEST = 40.0  # largest ratio of width to height of a word whose letters touch
_UNDERLINE, _THIN = 3.0, 0.3  # underline: smallest length and largest thickness, in letter heights
_TWO_LINES = 1.7  # smallest height of a component that may span two lines, in letter heights
_LEAST_LINE = 0.6  # smallest height of each line in a component of two lines, in letter heights
_VALLEY = 0.25  # largest ink of a pixel row between two lines, relative to the lines' fullest rows


def weighted_median(values: Indices | Floats, weight: Floats) -> float:
    """Return the weighted median of values, (N,)."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


class Components(NamedTuple):
    """Boxes of connected components, (N,) px; right and bottom are exclusive."""

    left: Indices
    top: Indices
    right: Indices
    bottom: Indices
    area: Indices

    @property
    def height(self) -> Indices:
        return self.bottom - self.top

    @property
    def width(self) -> Indices:
        return self.right - self.left

    @property
    def usual_height(self) -> float:
        """Median height, px, weighted by the square root of the area."""
        return weighted_median(self.height, np.sqrt(self.area))

    @property
    def length(self) -> float:
        """Length of the row of components, in typical heights."""
        return float(self.right.max() - self.left.min()) / self.usual_height

    def box(self, index: int) -> tuple[slice, slice]:
        """Return the slices of rows and columns of a component's box."""
        return np.s_[self.top[index] : self.bottom[index], self.left[index] : self.right[index]]

    def of(self, chosen: NDArray[np.bool_] | Indices) -> "Components":
        """Return the components that a mask or indices select."""
        return Components(*(column[chosen] for column in self))


def find_components(ink: Ink) -> tuple[Components, NDArray[np.int32]]:
    """Return the connected components of ``ink``, and the label of each pixel, (H, W), from 1."""
    # This algorithm is more than twice as fast as the default.
    _, labels, boxes, _ = cv2.connectedComponentsWithStatsWithAlgorithm(
        ink.view(np.uint8), 8, cv2.CV_32S, cv2.CCL_GRANA
    )
    left, top, width, height, area = boxes[1:].astype(np.int_).T
    components = Components(left, top, left + width, top + height, area)
    return components, np.asarray(labels, np.int32)


def usual_height(components: Components, shape: tuple[int, int]) -> float | None:
    """Return the typical height of letters, px; None without letters."""
    height, width = components.height, components.width
    is_letter = (height >= _LEAST_SIDE) & (height < _LARGEST_PART * min(shape))
    is_letter &= (width < _RULE * height) & (height < _RULE * width)
    # Exclude dots: the leader dots of a table of contents may outnumber the letters.
    is_letter &= (components.area < _DOT * width * height) | (height > 2 * width)
    return components.of(is_letter).usual_height if is_letter.any() else None


def like_letters(components: Components, height: float) -> NDArray[np.bool_]:
    """Return for each component, (N,), whether it may be a letter or several touching letters."""
    tall, wide = components.height, components.width
    right_size = (tall >= _LETTER[0] * height) & (tall <= _LETTER[1] * height)
    right_size &= (tall > _COMMA[0] * height) | (wide > _COMMA[1] * height)
    return np.asarray(right_size & (wide < _LONGEST * tall))


def find_rules(ink: Ink, height: float) -> tuple[Ink, Ink]:
    """Return two masks, (H, W): horizontal rules with underlines, and vertical rules."""
    page, long = ink.view(np.uint8), round(_RULE * height)
    # In some scripts letters hang from a line. Only a line without ink below is an underline.
    thick = max(3, round(_THIN * height))
    bare = page & ~np.pad(page, ((0, thick), (0, 0)))[thick:]
    # Widen the ink to connect the steps of a slightly tilted vertical rule.
    wide = cv2.dilate(page, np.ones((1, 3), np.uint8))
    underlines, rules, upright = (
        np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones(run, np.uint8)), np.uint8)
        for mask, run in (
            (bare, (1, round(_UNDERLINE * height))), (page, (1, long)), (wide, (long, 1))
        )
    )  # fmt: skip
    thicker = np.asarray(cv2.dilate(rules | underlines, np.ones((3, 1), np.uint8)), np.uint8)
    return thicker.view(np.bool_), (upright & page).view(np.bool_)


def part_lines(ink: Ink, components: Components, height: float) -> Ink:
    """Return the ink, (H, W), with cuts where letters of two successive lines touch."""
    wide, tall, parted = components.width, components.height, ink.copy()
    may_be_two = (tall > _TWO_LINES * height) & (tall < _LETTER[1] * height) & (2 * wide >= tall)
    around = np.ones((2 * round(_LEAST_LINE * height) + 1, 1), np.uint8)
    for k in np.flatnonzero(may_be_two).tolist():
        profile = ink[components.box(k)].sum(axis=1, dtype=np.float32)
        above, below = (np.maximum.accumulate(part) for part in (profile, profile[::-1]))
        valley = profile < _VALLEY * np.minimum(above, below[::-1])
        valley &= profile == cv2.erode(profile, around).ravel()
        parted[components.box(k)][valley] = False
    return parted


_NEIGHBORS = 10  # number of candidates for the next letter
_WIDEST_GAP = 3.8  # largest gap between two letters of a row, in heights of the taller letter
_LEAST_OVERLAP = 0.45  # smallest vertical overlap of two letters of a row, relative to the shorter
_LARGEST_RATIO = 2.8  # largest ratio of neighbors' heights; a parenthesis is 2.5 times as tall as x
_LEAST_SPACE = 0.35  # narrowest space between words, in letter heights
_LANE_PX = 3.0  # lanes are searched in a reduced image with letters of this height, px
_NARROWEST = 0.75  # smallest width of a lane, in letter heights
_LANES = ((1.25, 15.0), (1.9, 8.0))
"""Two kinds of lanes: smallest width, in word spaces, and smallest length, in letter heights."""
_LANE_REACH = 16.0  # largest distance from a lane to the print on each side, in letter heights
_SHORT_LINES = 6.5  # largest height that short lines leave blank beside a lane, in letter heights
_LANE_GAP = 25.0  # largest height of an interruption that does not end a lane, in letter heights


def find_rows(letters: Components, ink: Ink, walls: Ink, height: float) -> list[Components]:
    """Return the letters of each row, from left to right.

    Rows end at walls and at lanes of ``ink``, (H, W). ``walls`` is a mask, (H, W), of vertical
    rules and pictures.
    """
    if not len(letters.area):
        return []
    first, second, gap = _link_neighbors(letters)
    spaces = gap[gap > _LEAST_SPACE * letters.height[first]]
    lanes = _lanes(ink, height, float(np.median(spaces)) if len(spaces) else 0.0)
    start, end = letters.right[first] - 1, letters.left[second]
    middle = (letters.top[first] + letters.bottom[first]) // 2
    passed = (np.cumsum(mask, axis=1, dtype=np.int32) for mask in (walls, lanes))
    walled, laned = (count[middle, end] > count[middle, start] for count in passed)
    # A lane may cross a headline between two words: there, end a row only at a wide gap.
    wide = 2 * gap > _NARROWEST * (letters.height[first] + letters.height[second])
    free = ~(walled | (laned & wide))
    following = dict(zip(first[free].tolist(), second[free].tolist(), strict=True))
    rows = []
    for letter in set(range(len(letters.area))) - set(following.values()):
        row = [letter]
        while row[-1] in following:
            row.append(following[row[-1]])
        rows.append(letters.of(np.array(row)))
    return rows


def _lanes(ink: Ink, height: float, space: float) -> Ink:
    """Return a mask, (H, W), of lanes: tall white gaps between columns of print."""
    part, rows = max(1, int(height / _LANE_PX)), len(ink)
    ink = np.logical_or.reduceat(ink, np.arange(0, len(ink), part), axis=0)
    page = ink.view(np.uint8)
    beside = np.ones((1, round(_LANE_REACH * height)), np.uint8)
    leading = np.ones((round(_SHORT_LINES * height / part) | 1, 1), np.uint8)
    white = ~ink
    for x in (0, beside.size - 1):
        near = cv2.dilate(page, beside, anchor=(x, 0))
        white &= cv2.morphologyEx(near, cv2.MORPH_CLOSE, leading) > 0
    lanes = np.zeros_like(ink)
    for spaces, length in _LANES:
        width = max(3, round(max(_NARROWEST * height, spaces * space)))
        lane = np.ones((round(length * height / part), width), np.uint8)
        lanes |= cv2.morphologyEx(white.view(np.uint8), cv2.MORPH_OPEN, lane) > 0
    # A lane is not found where a column beside it has no print. Close such a gap if it is white.
    longer = np.ones((round(_LANE_GAP * height / part) | 1, 1), np.uint8)
    within = cv2.morphologyEx(lanes.view(np.uint8), cv2.MORPH_CLOSE, longer, borderValue=0)
    wide = cv2.morphologyEx(1 - page, cv2.MORPH_OPEN, np.ones((3, width), np.uint8))
    lanes |= cv2.min(within, wide) > 0
    return np.repeat(lanes, part, axis=0)[:rows]


def _link_neighbors(letters: Components) -> tuple[Indices, Indices, Indices]:
    """Link letters to their right neighbors, closest letters first. Return three arrays with an
    entry for each link: index of the left letter, index of the right letter, and gap, px."""
    height, middle = letters.height, (letters.top + letters.bottom) / 2
    # Vertical distance counts twice in the search for near letters.
    starts = np.column_stack([letters.left, 2 * middle]).astype(np.float32)
    ends = np.column_stack([letters.right, 2 * middle]).astype(np.float32)
    count = min(_NEIGHBORS, len(height))
    _, neighbors = cv2.batchDistance(ends, starts, cv2.CV_32F, normType=cv2.NORM_L2, K=count)
    first, second = np.repeat(np.arange(len(height)), count), neighbors.ravel().astype(np.intp)
    one, other = letters.of(first), letters.of(second)
    taller = np.maximum(one.height, other.height)
    lower = np.minimum(one.height, other.height)
    gap = other.left - one.right
    beside = np.minimum(one.bottom, other.bottom) - np.maximum(one.top, other.top)
    is_link = (gap <= _WIDEST_GAP * taller) & (other.left + other.right > one.left + one.right)
    is_link &= (beside >= _LEAST_OVERLAP * lower) & (taller <= _LARGEST_RATIO * lower)
    # The cost of a link is the gap between the letters plus their vertical offset, px.
    cost = np.where(is_link, np.maximum(gap, 0) + lower - beside, np.inf)
    links, begun, ended = [], set(), set()
    for k in np.argsort(cost, kind="stable")[: np.count_nonzero(is_link)]:
        start, end = first[k], second[k]
        if start not in begun and end not in ended:
            links.append(k)
            begun.add(start)
            ended.add(end)
    return first[links], second[links], gap[links]


_WORD = 1.3  # a component wider than this, in letter heights, is several touching letters
_PIECE = 0.6  # width of the pieces into which touching letters are divided, in letter heights
_DEGREES = (8.0, 20.0, 40.0)
"""Smallest row lengths, in letter heights, for a baseline of polynomial degree 1, 2 and 3."""
_DESCENDING = 2.5  # distances below a baseline are multiplied by this: descenders get small weights
_ROUNDS = 5  # iterations of the robust fit
_X_HEIGHTS = np.arange(0.4, 1.3, 0.03)  # candidate x-heights, in letter heights
_NEAR = (0.1, 0.5)  # tolerance of heights: 0.1 x-heights + 0.5 px
_TALL, _DEEP = (1.2, 1.65), (0.15, 0.65)
"""Ranges of ascender height and descender depth from the baseline, in x-heights."""
_UNDECIDED = 0.3  # the baseline is raised if more than this share of letter bottoms is above it
_STROKES = (0.75, 2.9)  # range of `Baseline.strokes` in text; usual print has 0.9 to 1.9
_TOUCHING = 1.3  # if the median width of a row's letters exceeds this, in x-heights, they touch
_ON_LEVELS = 0.65  # smallest share of letters with typical heights in a row of text
_TOUCHING_ON_LEVELS = 0.52  # as `_ON_LEVELS`, for a row of touching letters
_FEW_ON_LEVELS = 0.8  # as `_ON_LEVELS`, for a row of fewer than `MANY` letters
MANY = 8  # a row of fewer letters must meet stricter conditions to be text
_SOLID = 0.75  # smallest share of ink in the box of a disc or a square


@dataclass(frozen=True, eq=False)
class Baseline:
    """Row of letters with its baseline and its heights, px."""

    letters: Components
    left: float
    right: float
    curve: Floats  # (D,) polynomial coefficients, lowest first; the argument is x - left
    x_height: float
    rise: Floats  # (P,) heights of letter tops above the baseline
    fall: Floats  # (P,) depths of letter bottoms below the baseline
    strokes: float  # number of strokes at half the x-height, in a length of one x-height

    def at(self, x: NDArray[np.float64]) -> Floats:
        """Return y of the baseline at x, linearly extrapolated beyond the row's ends."""
        return curve_at(self.curve, x - self.left, self.right - self.left)

    @property
    def middle_y(self) -> float:
        """Baseline's y halfway along the row."""
        return float(self.at(np.array((self.left + self.right) / 2)))

    @property
    def is_text(self) -> bool:
        """Whether the number of strokes is as in text, and most letters have typical heights."""
        letters = self.letters
        # Dashes and wide spaces have few strokes, so accept fewer strokes in a row with them.
        covered = min(1.0, float(letters.width.sum()) / (self.right - self.left))
        touching = float(np.median(letters.width)) > _TOUCHING * self.x_height
        least = _TOUCHING_ON_LEVELS if touching else _ON_LEVELS
        least = least if len(self.rise) >= MANY else _FEW_ON_LEVELS
        wide = float(np.median(letters.width / letters.height))
        filled = float(np.median(letters.area / (letters.width * letters.height)))
        if wide >= 1 and filled >= _SOLID and len(letters.area) >= MANY:
            return False
        return _STROKES[0] * covered < self.strokes < _STROKES[1] and self.on_levels >= least

    @property
    def on_levels(self) -> float:
        """Share of letters with typical tops or with typical bottoms, whichever is smaller."""
        near = _NEAR[0] * self.x_height + _NEAR[1]
        deep = (self.fall > _DEEP[0] * self.x_height) & (self.fall < _DEEP[1] * self.x_height)
        low = (np.abs(self.fall) < near) | deep
        return float(min(_on_levels(self.rise, self.x_height).sum(axis=0).mean(), low.mean()))


def measure_row(ink: Ink, letters: Components, slope: float) -> Baseline:
    """Measure a row of letters in ``ink``, (H, W).

    The baseline is a smooth curve through the lower ends of most letters. The x-height is chosen so
    that most letters have x-height or ascender height. ``slope`` is the expected slope; a very
    short row gets this slope.
    """
    left, right, height = letters.left.min(), letters.right.max(), letters.usual_height
    x, top, bottom = _pieces(ink, letters, height)
    degree = min(int(np.searchsorted(_DEGREES, letters.length)), max(0, len(x) - 2))
    curve = np.append(_fitted(x - left, bottom - slope * (x - left), degree), 0.0)
    curve[1] += slope
    off = bottom - polynomial.polyval(x - left, curve)
    above = off < -_NEAR[0] * height - _NEAR[1]
    if above.mean() > _UNDECIDED:
        # Many letter bottoms are above the curve, so it follows the descenders. Raise it.
        curve[0] += np.median(off[above])
    base = polynomial.polyval(x - left, curve)
    rise = base - top
    tried = height * _X_HEIGHTS
    score = np.tensordot((1, 0.9), _on_levels(rise, tried[:, None]).mean(axis=-1), 1)
    x_height = float(tried[score.argmax()])
    alike = rise[np.abs(rise - x_height) < _NEAR[0] * x_height + _NEAR[1]]
    # Take the mean of the measured x-heights, or the minimum if only the minimum fits all letters.
    heights = (float(alike.mean()), float(alike.min())) if len(alike) else (x_height,)
    x_height = max(heights, key=lambda tried: _on_levels(rise, tried).any(axis=0).all())
    along = np.arange(right - left)
    halfway = np.rint(polynomial.polyval(along, curve) - x_height / 2)
    dark = ink[np.clip(halfway, 0, len(ink) - 1).astype(int), along + left]
    strokes = float(np.count_nonzero(dark[1:] > dark[:-1]) / (right - left) * x_height)
    return Baseline(
        letters, float(left), float(right), curve, x_height, rise, bottom - base, strokes
    )


def _on_levels(rise: Floats, x_height: Floats | float) -> NDArray[np.bool_]:
    """Return two masks, (2, …, N): letters with x-height, and letters with ascender height."""
    near = np.abs(rise - x_height) < _NEAR[0] * x_height + _NEAR[1]
    return np.array([near, ~near & (rise > _TALL[0] * x_height) & (rise < _TALL[1] * x_height)])


def _pieces(ink: Ink, letters: Components, height: float) -> tuple[Floats, Floats, Floats]:
    """Return the middle x, top and bottom of letters, (P,) each. Touching letters are divided."""
    long = letters.width > _WORD * height
    rows = [np.stack([(letters.left + letters.right) / 2, letters.top, letters.bottom])[:, ~long]]
    for k in np.flatnonzero(long).tolist():
        box = ink[letters.box(k)]
        starts = np.linspace(0, box.shape[1], round(box.shape[1] / height / _PIECE) + 1)
        inked = np.add.reduceat(box, starts[:-1].astype(int), axis=1) > 0
        top = letters.top[k] + inked.argmax(axis=0)
        bottom = letters.bottom[k] - inked[::-1].argmax(axis=0)
        x = letters.left[k] + (starts[1:] + starts[:-1]) / 2
        rows.append(np.stack([x, top, bottom])[:, inked.any(axis=0)])
    x, top, bottom = np.hstack(rows).astype(np.float64)
    return x, top, bottom


def _fitted(x: Floats, y: Floats, degree: int) -> Floats:
    """Return the coefficients of a polynomial near most points (robust fit)."""
    weight, curve = np.ones_like(y), np.zeros(1)
    for _ in range(_ROUNDS):
        # ``full`` avoids a warning about the undetermined slope if all points have the same x.
        curve = np.asarray(polynomial.polyfit(x, y, degree, full=True, w=weight)[0])
        away = y - polynomial.polyval(x, curve)
        # Enlarge distances below the curve, so that descenders get small weights.
        off = np.where(away > 0, _DESCENDING, 1) * np.abs(away)
        typical = float(np.partition(off, len(off) // 2)[len(off) // 2])
        # Weights of Geman and McClure: distant points hardly count.
        weight = 1 / (1 + (off / max(1.5 * typical, 0.3)) ** 2)
    return curve
