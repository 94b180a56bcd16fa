"""Baselines of rows of letters, through skew and curvature, with the marks at their ends."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.pages.spots import Spots, widest_white

Floats = NDArray[np.float64]

_STEPS = 20  # rows of the profile per height of its letters
_BAND = 1.6  # half height of the band around a row, in heights of its letters
_COLUMNS = 8  # columns per height of its letters
_PIECE = 5.0  # length of a piece that is shifted as one, in heights of its letters
_SUPPORT = (2, 4, 8)  # fewest pieces for a slope, a bend, and a second bend of a line
_SHIFT = 0.6  # largest shift of a piece from the first guess, in heights of its letters
_RISE = 0.5  # weight of an edge at the top of letters, relative to one at the bottom
_ROUNDS, _SETTLED = 3, 0.03
"""Most rounds, and largest change, in heights of its letters, after which no other follows."""
_ROBUST = 5  # rounds of weights against outliers
_STROKE = 96  # density at which a stroke begins: thin strokes of small print are not black
_TALL = 0.95
"""Part of the letters that is not higher than a tall one; a few are accented or touch others."""
_LEVEL = 1e-10  # weight of a level line beside the points
_GAP = 0.3  # white that separates two lines, in x-heights
_CLOSE = 0.02  # distance of the pieces from a good curve, in heights of its letters
_WORTH = 0.7  # factor by which a curve of higher degree must reduce most distances


@dataclass(frozen=True, eq=False)
class Baseline:
    """Row of letters, straightened and measured, in px of the page or in x-heights."""

    left: float
    right: float
    baseline: Floats  # (D,) coefficients, lowest first, over the distance from left
    x_height: float
    profile: Floats  # (N,) ink at each height, in [0, 1], from the top down
    profile_top: float  # x-heights above the baseline
    step: float  # from row to row of the profile, x-heights
    strokes: float  # met halfway up an x, per x-height of the row's length
    reach: tuple[float, float]  # of tall and of deep letters from the baseline, x-heights

    def at(self, x: NDArray[Any]) -> Floats:
        """Return the baseline's y at x, px; straight beyond the row's ends."""
        return curve_at(
            self.baseline, np.asarray(x, np.float64) - self.left, self.right - self.left
        )

    def y_at(self, x: float) -> float:
        """Return the same at one place; numpy takes fifty times as long."""
        distance, inside = x - self.left, min(max(x - self.left, 0.0), self.right - self.left)
        y = slope = 0.0
        for each in self.baseline[::-1].tolist():
            y, slope = y * inside + each, slope * inside + y
        return y + slope * (distance - inside)

    @property
    def middle_y(self) -> float:
        """Baseline's y halfway along the row, px."""
        return self.y_at((self.left + self.right) / 2)

    @cached_property
    def heights(self) -> Floats:
        """Height of each row of the profile over the baseline, (N,), in x-heights."""
        return np.asarray(self.profile_top - np.arange(len(self.profile)) * self.step)

    def ink_between(self, low: float, high: float) -> float:
        """Return the mean ink between two heights over the baseline, in x-heights."""
        chosen = (self.heights >= low) & (self.heights <= high)
        return float(self.profile[chosen].mean()) if chosen.any() else 0.0

    def least_ink(self, low: float, high: float) -> float:
        """Return the least ink in a gap between two heights over the baseline, in x-heights."""
        chosen = self.profile[(self.heights >= low) & (self.heights <= high)]
        gap = max(1, min(round(_GAP / self.step), len(chosen)))
        if not len(chosen):
            return 0.0
        return float(np.convolve(chosen, np.ones(gap) / gap, "valid").min())


def curve_at(coefficients: Floats, distance: Floats, length: float) -> Floats:
    """Return a curve at distances from its start; straight beyond its ends."""
    inside = np.clip(distance, 0, length)
    return _values(coefficients, inside) + _values(_derived(coefficients), inside) * (
        distance - inside
    )


def _values(coefficients: Floats, x: Floats) -> Floats:
    """Return a polynomial's values; numpy's own way takes several times as long."""
    value = np.zeros_like(x)
    for each in coefficients[::-1].tolist():
        value = value * x + each
    return value


def _derived(coefficients: Floats) -> Floats:
    return coefficients[1:] * np.arange(1, len(coefficients))


def follow_baseline(density: NDArray[np.uint8], row: Spots, slope: float | None = None) -> Baseline:
    """Return the measured baseline of a row of letters in a density of ink, (H, W) uint8, 255 full.

    Pieces of the row are shifted up and down until their ink fits that of the whole row best; a
    smooth curve goes through them. The baseline is where the ink ends most abruptly, the top of an
    x where it begins so. ``slope`` is that of the lines around, for a row too short to measure its
    own.
    """
    height = row.usual_height
    left, right = float(row.left.min()), float(row.right.max())
    center = (row.left + row.right) / 2 - left
    middle = (row.top + row.bottom) / 2
    weight = np.sqrt(row.area)
    degree = _degree((right - left) / height / _PIECE)
    if slope is None:
        most = min(degree, _degree(len(middle)))
        curve = _smooth(center, middle, weight, most, _CLOSE * height)
    else:
        curve = np.array([np.average(middle - slope * center, weights=weight), slope])
    for _ in range(_ROUNDS):
        pieces, at = _pieces(density, left, right, curve, height)
        shift, weight = _shifts(pieces)
        away = shift * height / _STEPS
        more = _smooth(at, away, weight, degree, _CLOSE * height)
        size = max(len(curve), len(more))
        curve = np.pad(curve, (0, size - len(curve))) + np.pad(more, (0, size - len(more)))
        if np.abs(_values(more, at)).max() < _SETTLED * height:
            break
    pieces, _ = _pieces(density, left, right, curve, height)
    profile = pieces.mean(axis=0)
    top, base = _edges(profile)
    curve[0] += (base / _STEPS - _BAND) * height
    x_height = (base - top) / _STEPS * height
    strokes = _strokes(density, left, right, curve, x_height)
    step = 1 / (base - top)
    bottom = _values(curve, center)
    tall, deep = (
        float(np.sort(edge)[int(_TALL * (len(edge) - 1) + 0.5)]) / x_height
        for edge in (bottom - row.top, row.bottom - bottom)
    )
    return Baseline(left, right, curve, x_height, profile, base * step, step, strokes, (tall, deep))


def _degree(support: float) -> int:
    """Return the degree of a curve through so many pieces of a line."""
    return int(np.searchsorted(_SUPPORT, support, side="right"))


def _smooth(x: Floats, y: Floats, weight: Floats, most: int, close: float) -> Floats:
    """Return the coefficients of the simplest curve that is close to most points."""
    found, away = _fitted(x, y, weight, min(most, 1))
    for degree in range(2, most + 1):
        if away < close:
            break
        finer, finer_away = _fitted(x, y, weight, degree)
        if finer_away > _WORTH * away:
            continue
        found, away = finer, finer_away
    return found


def _fitted(x: Floats, y: Floats, weight: Floats, degree: int) -> tuple[Floats, float]:
    """Return a curve's coefficients, fitted with low weight on outliers, and the distance."""
    scale = max(1.0, float(np.abs(x).max(initial=0)))
    powers = np.power.outer(x / scale, np.arange(degree + 1))
    robust = np.ones_like(y)
    for _ in range(_ROBUST):
        weighted = powers.T * (weight * robust)
        normal = weighted @ powers
        # Points in one place determine no slope: it is the least one then.
        normal.flat[:: degree + 2] += _LEVEL * normal[0, 0]
        found = np.linalg.solve(normal, weighted @ y)
        away = np.abs(y - powers @ found)
        # Half of the time goes into numpy's median.
        usual = float(np.sort(away)[len(away) // 2])
        # Geman and McClure's weights.
        robust = 1 / (1 + (away / max(1.5 * usual, 0.25)) ** 2) ** 2
    return np.asarray(found / scale ** np.arange(degree + 1)), usual


def _pieces(
    density: NDArray[np.uint8], left: float, right: float, curve: Floats, height: float
) -> tuple[Floats, Floats]:
    """Return the ink of each piece at each height along a curve, (P, N), and its place, (P,)."""
    count = max(1, round((right - left) / height / _PIECE))
    columns = max(8, round((right - left) / height * _COLUMNS / count)) * count
    along = (np.arange(columns) + 0.5) * (right - left) / columns
    across = np.arange(round(2 * _BAND * _STEPS) + 1) * height / _STEPS - _BAND * height
    x = np.broadcast_to(along + left, (len(across), columns))
    y = _values(curve, along) + across[:, None]
    # A pixel's middle is half a pixel from its edge.
    band = cv2.remap(
        density, np.asarray(x - 0.5, np.float32), np.asarray(y - 0.5, np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=0,
    )  # fmt: skip
    pieces = band.reshape(len(across), count, -1).mean(axis=2).T / 255
    return pieces, along.reshape(count, -1).mean(axis=1)


def _strokes(
    density: NDArray[np.uint8], left: float, right: float, curve: Floats, x_height: float
) -> float:
    """Return the number of strokes crossed at half the x-height, per x-height."""
    distance = np.arange(0.0, right - left)
    y = _values(curve, distance) - x_height / 2
    inside = (y >= 0) & (y < len(density))
    met = density[y[inside].astype(int), (distance[inside] + left).astype(int)] > _STROKE
    return float(np.count_nonzero(np.diff(met.astype(np.int8)) == 1) / (right - left) * x_height)


def _shifts(pieces: Floats) -> tuple[Floats, Floats]:
    """Return the offset of each piece from the mean, (P,) steps, and its reliability."""
    most = round(_SHIFT * _STEPS)
    edges = np.diff(cv2.GaussianBlur(pieces, (0, 0), sigmaX=1.5, sigmaY=1e-6), axis=1)
    # More letters end at the baseline than begin at the top of an x: figures do not.
    edges = np.where(edges > 0, _RISE * edges, edges) * np.hanning(edges.shape[1])
    usual = edges.mean(axis=0)
    spread = np.fft.rfft(edges, 2 * edges.shape[1])
    match = np.fft.irfft(spread * np.conj(np.fft.rfft(usual, 2 * edges.shape[1])))
    match = np.concatenate([match[:, -most:], match[:, : most + 1]], axis=1)
    best = match.argmax(axis=1)
    best = np.clip(best, 1, 2 * most - 1)
    rows = np.arange(len(match))
    before, here, after = (match[rows, best + k] for k in (-1, 0, 1))
    bend = np.maximum(2 * here - before - after, 1e-12)
    return best - most + np.clip((after - before) / 2 / bend, -0.5, 0.5), np.maximum(here, 1e-9)


def _edges(profile: Floats) -> tuple[float, float]:
    """Return the top and bottom of an x in a profile: its steepest rise and fall, in steps."""
    slope = np.diff(cv2.GaussianBlur(profile[None], (0, 0), sigmaX=1.0).ravel())
    middle = len(profile) // 2
    lowest = middle + round(0.85 * _STEPS)
    base = middle + int(slope[middle:lowest].argmin())
    highest, nearest = base - round(1.2 * _STEPS), base - round(0.35 * _STEPS)
    top = highest + int(slope[highest:nearest].argmax())
    return _peak(slope, top), _peak(-slope, base)


def _peak(values: Floats, at: int) -> float:
    before, here, after = values[at - 1 : at + 2]
    bend = 2 * here - before - after
    # The slope at an index lies half a row beyond it.
    return at + 0.5 + (float((after - before) / 2 / bend) if bend > 0 else 0.0)


_THINNEST, _SHORTEST, _LONGEST = 0.06, 0.15, 2.5
"""Shorter and longer side of a dot, a dash or a single letter, in x-heights."""
_REACH = 1.2  # largest distance of a mark from its line's end, in x-heights
_ABOVE, _BELOW = 1.6, 0.5
"""Largest distance of a mark's middle above and below the baseline, in x-heights."""
_FARTHEST = 5.0
"""Longest row of marks, or gap to a line's other part, beyond a line's end, in x-heights."""
_MEETING = 1.2  # widest white between two parts of a line that is no gutter, in x-heights
_OF_A_LINE = 0.7  # least height of a line of its own, as a part of an x beside it
_OF_TWO_LINES = 2.0  # length of letters of two lines that touch, in x-heights
_OF_TEXT = 0.75  # strokes per x-height of a line of text; dots and accents have fewer
_HANGING = 1.2  # lowest end below a line of a mark that hangs from it, in x-heights
_ONE_BASELINE = 0.35  # largest offset of the baselines of two parts of a line, in x-heights
_ONE_SIZE = 1.5  # largest ratio of their x-heights


def with_marks(baselines: list[Baseline], spots: Spots) -> list[Baseline]:
    """Extend lines by the marks at their ends, and join those that then meet."""
    lines = sorted(_lengthened(baselines, spots), key=lambda line: line.left)
    joined: list[Baseline] = []
    for line in lines:
        before = [k for k, other in enumerate(joined) if _continues(other, line, spots)]
        if before:
            nearest = max(before, key=lambda k: joined[k].right)
            joined[nearest] = _joined(joined[nearest], line)
        else:
            joined.append(line)
    return [line for line in joined if not any(_belongs(line, other) for other in joined)]


def _lengthened(baselines: list[Baseline], spots: Spots) -> list[Baseline]:
    """Return the lines with the marks beside them; each mark goes to the nearest line."""
    x, y = (spots.left + spots.right) / 2, (spots.top + spots.bottom) / 2
    nearest = np.full(len(x), -1)
    least = np.full(len(x), np.inf)
    for index, baseline in enumerate(baselines):
        size = baseline.x_height
        above = (baseline.at(x) - y) / size
        beyond = np.maximum(np.maximum(baseline.left - x, x - baseline.right), 0) / size
        smaller = np.minimum(spots.width, spots.height) / size
        larger = np.maximum(spots.width, spots.height) / size
        mark = (above < _ABOVE) & (above > -_BELOW)
        mark &= (smaller > _THINNEST) & (larger > _SHORTEST) & (larger < _LONGEST)
        away = np.abs(above - 0.5) + beyond
        nearer = mark & (beyond < _FARTHEST) & (away < least)
        nearest[nearer] = index
        least[nearer] = away[nearer]
    return [_reaching(baseline, spots.of(nearest == k)) for k, baseline in enumerate(baselines)]


def _reaching(baseline: Baseline, marks: Spots) -> Baseline:
    """Extend a line from mark to mark, on either side."""
    left, right = baseline.left, baseline.right
    reach = _REACH * baseline.x_height
    for k in np.argsort(marks.left):
        if marks.left[k] < right + reach:
            right = max(right, float(marks.right[k]))
    for k in np.argsort(-marks.right):
        if marks.right[k] > left - reach:
            left = min(left, float(marks.left[k]))
    return between(baseline, left, right)


def between(baseline: Baseline, left: float, right: float) -> Baseline:
    """Return a line with other ends, px."""
    moved, derived, factor = [], baseline.baseline, 1.0
    for power in range(len(baseline.baseline)):
        # Taylor's series around the new end.
        moved.append(float(_values(derived, np.array(left - baseline.left))) / factor)
        derived, factor = _derived(derived), factor * (power + 1)
    return replace(baseline, left=left, right=right, baseline=np.array(moved))


def _continues(line: Baseline, other: Baseline, spots: Spots) -> bool:
    """Return whether another line continues one, directly or by ink between them."""
    size = min(line.x_height, other.x_height)
    if other.left - line.right > _FARTHEST * size or other.right <= line.right:
        return False
    if max(line.x_height, other.x_height) > _ONE_SIZE * size:
        return False
    meeting = (other.left + min(line.right, other.right)) / 2
    base = line.y_at(meeting)
    if abs(base - other.y_at(meeting)) > _ONE_BASELINE * size:
        return False
    if other.left <= line.right:
        return True
    white = widest_white(spots, line.right, other.left, base - size, base)
    return white[1] - white[0] < _MEETING * size


def _joined(line: Baseline, other: Baseline) -> Baseline:
    """Return two lines as one."""
    longer = max(line, other, key=lambda each: each.right - each.left)
    x = np.linspace(line.left, other.right, 50)
    y = np.where(x < (line.right + other.left) / 2, line.at(x), other.at(x))
    degree = len(longer.baseline) - 1 or 1
    baseline = np.asarray(polynomial.polyfit(x - line.left, y, degree), np.float64)
    return replace(longer, left=line.left, right=other.right, baseline=baseline)


def _belongs(line: Baseline, other: Baseline) -> bool:
    """Return whether a line consists of dots and accents of another one."""
    size = other.x_height
    if line is other or (
        line.x_height > _OF_A_LINE * size and line.right - line.left > _OF_TWO_LINES * size
    ):
        return False
    middle = (line.left + line.right) / 2
    above = (other.y_at(middle) - line.y_at(middle)) / size
    if line.strokes > _OF_TEXT and not 0 < above < 1:
        # Small print under a headline.
        return False
    return other.left < middle < other.right and -_HANGING < above < _ABOVE
