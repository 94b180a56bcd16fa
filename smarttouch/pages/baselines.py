"""Rows of letters measured: baseline through skew and curvature, height of an x, and whether they
are text."""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from smarttouch.pages.components import Components, Ink
from smarttouch.pages.page_image import curve_at

Floats = NDArray[np.float64]

_WORD, _PIECE = 1.3, 0.6  # width above which a component is several letters, and of a piece of it
_DEGREES = (8.0, 20.0, 40.0)  # least lengths of lines with a slope, a bend and a second bend
_DESCENDING = 2.5  # weight of a distance below a baseline
_ROUNDS = 8  # rounds of weights against outliers
_X_HEIGHTS = np.arange(0.4, 1.3, 0.03)  # heights of an x that are tried, in letter heights
_NEAR = (0.1, 0.5)  # distance within which letters are equally high: in x-heights, plus pixels
_TALL, _DEEP = (1.2, 1.65), (0.15, 0.65)
"""Ranges of the reach of ascenders and of descenders from the baseline, in x-heights."""
_UNDECIDED = 0.2  # part of the letters that end above a baseline that may be too low
_LEAST_X_HEIGHT_PX = 3.5  # least x-height of readable print
_STROKES = (0.75, 2.9)  # strokes per x-height of letters; print has 0.9 to 1.9
_TOUCHING = 1.3  # usual width of components in which letters run together, in x-heights
_ON_LEVELS, _TOUCHING_ON_LEVELS, _FEW_ON_LEVELS = 0.6, 0.5, 0.8
"""Least part of the letters that begin and end at usual heights, where they touch, and of few."""
_MANY, _SOLID = 8, 0.75
"""Letters of a line that stands for itself; filled part of a box above which it is a disc or a
square, if it is as wide as high."""


@dataclass(frozen=True, eq=False)
class Baseline:
    """Measured row of letters, px."""

    letters: Components
    left: float
    right: float
    curve: Floats  # (D,) coefficients of y, lowest first, over the distance from left
    x_height: float
    rise: Floats  # (P,) of the letters, or pieces of words, above the baseline
    fall: Floats  # (P,) of the same below it
    strokes: float  # met halfway up an x, per x-height of the row's length

    def at(self, x: NDArray[np.float64]) -> Floats:
        """Return the baseline's y at x; straight beyond the row's ends."""
        return curve_at(self.curve, x - self.left, self.right - self.left)

    @property
    def middle_y(self) -> float:
        """Baseline's y halfway along the row."""
        return float(polynomial.polyval((self.right - self.left) / 2, self.curve))

    @property
    def is_too_small(self) -> bool:
        """Whether it may be a line of text too small to be read."""
        return self.x_height < _LEAST_X_HEIGHT_PX and len(self.letters.area) >= _MANY

    @property
    def is_text(self) -> bool:
        """Whether it has the strokes of letters, most of which begin and end at usual heights."""
        letters = self.letters
        # Dashes and wide spaces have little ink.
        covered = min(1.0, float(letters.width.sum()) / (self.right - self.left))
        touching = float(np.median(letters.width)) > _TOUCHING * self.x_height
        wide = float(np.median(letters.width / letters.height))
        filled = float(np.median(letters.area / (letters.width * letters.height)))
        least = _TOUCHING_ON_LEVELS if touching else _ON_LEVELS
        return (
            self.x_height >= _LEAST_X_HEIGHT_PX
            and _STROKES[0] * covered < self.strokes < _STROKES[1]
            and (wide < 1 or filled < _SOLID or len(letters.area) < _MANY)
            and self.on_levels >= (least if len(self.rise) >= _MANY else _FEW_ON_LEVELS)
        )

    @property
    def on_levels(self) -> float:
        """Part of the letters, or pieces of words, that begin and end at usual heights."""
        near = _NEAR[0] * self.x_height + _NEAR[1]
        deep = (self.fall > _DEEP[0] * self.x_height) & (self.fall < _DEEP[1] * self.x_height)
        low = (np.abs(self.fall) < near) | deep
        return float(min(_on_levels(self.rise, self.x_height).sum(axis=0).mean(), low.mean()))


def measure_row(ink: Ink, letters: Components, slope: float | None = None) -> Baseline:
    """Measure a row of letters in ``ink``, (H, W).

    A smooth curve goes through the lower ends of most letters. Most of them are as high as an x, or
    as an ascender. ``slope`` is that of the lines around, for a row too short to measure its own.
    """
    height = letters.usual_height
    left, right = float(letters.left.min()), float(letters.right.max())
    x, top, bottom = _pieces(ink, letters, height)
    if slope is None:
        degree = min(int(np.searchsorted(_DEGREES, (right - left) / height)), max(0, len(x) - 2))
        curve = _fitted(x - left, bottom, degree)
    else:
        curve = np.append(_fitted(x - left, bottom - slope * (x - left), 0), slope)
    row = _on_curve(ink, letters, curve, x, top, bottom)
    above = row.fall < -_NEAR[0] * row.x_height - _NEAR[1]
    if above.mean() > _UNDECIDED:
        # Where most letters descend, the others stand on the line.
        curve = np.append(curve[0] + np.median(row.fall[above]), curve[1:])
        higher = _on_curve(ink, letters, curve, x, top, bottom)
        row = max(row, higher, key=lambda each: each.on_levels)
    return row


def _on_curve(
    ink: Ink, letters: Components, curve: Floats, x: Floats, top: Floats, bottom: Floats
) -> Baseline:
    """Return a row with such a baseline; its pieces have such middles, tops and bottoms, (P,)."""
    left, right, height = letters.left.min(), letters.right.max(), letters.usual_height
    base = polynomial.polyval(x - left, curve)
    rise = base - top
    tried = height * _X_HEIGHTS
    score = np.tensordot((1, 0.9), _on_levels(rise, tried[:, None]).mean(axis=-1), 1)
    x_height = float(tried[score.argmax()])
    alike = np.abs(rise - x_height) < _NEAR[0] * x_height + _NEAR[1]
    x_height = float(rise[alike].mean()) if alike.any() else x_height
    along = np.arange(right - left)
    halfway = np.rint(polynomial.polyval(along, curve) - x_height / 2)
    dark = ink[np.clip(halfway, 0, len(ink) - 1).astype(int), along + left]
    strokes = float(np.count_nonzero(dark[1:] > dark[:-1]) / (right - left) * x_height)
    return Baseline(
        letters, float(left), float(right), curve, x_height, rise, bottom - base, strokes
    )


def _on_levels(rise: Floats, x_height: Floats | float) -> NDArray[np.bool_]:
    """Return which letters are as high as an x, and which as an ascender or capital, (2, …, N)."""
    near = np.abs(rise - x_height) < _NEAR[0] * x_height + _NEAR[1]
    return np.array([near, ~near & (rise > _TALL[0] * x_height) & (rise < _TALL[1] * x_height)])


def _pieces(ink: Ink, letters: Components, height: float) -> tuple[Floats, Floats, Floats]:
    """Return middle, top and bottom of letters, (P,) each; of words run together, of pieces."""
    long = letters.width > _WORD * height
    rows = [np.stack([(letters.left + letters.right) / 2, letters.top, letters.bottom])[:, ~long]]
    for k in np.flatnonzero(long):
        box = ink[letters.top[k] : letters.bottom[k], letters.left[k] : letters.right[k]]
        starts = np.linspace(0, box.shape[1], round(box.shape[1] / height / _PIECE) + 1)
        inked = np.add.reduceat(box, starts[:-1].astype(int), axis=1) > 0
        top = letters.top[k] + inked.argmax(axis=0)
        bottom = letters.bottom[k] - inked[::-1].argmax(axis=0)
        x = letters.left[k] + (starts[1:] + starts[:-1]) / 2
        rows.append(np.stack([x, top, bottom])[:, inked.any(axis=0)])
    x, top, bottom = np.hstack(rows).astype(np.float64)
    return x, top, bottom


def _fitted(x: Floats, y: Floats, degree: int) -> Floats:
    """Return the coefficients of a curve that is close to most points."""
    scale = max(1.0, float(np.abs(x).max(initial=0)))
    powers = np.power.outer(x / scale, np.arange(degree + 1))
    weight = np.ones_like(y)
    for _ in range(_ROUNDS):
        weighted = powers.T * weight
        # Points in one place determine no slope: it is the least one then.
        level = 1e-9 * weight.sum() * np.eye(degree + 1)
        found = np.linalg.solve(weighted @ powers + level, weighted @ y)
        away = y - powers @ found
        # Descenders are all on one side.
        off = np.where(away > 0, _DESCENDING, 1) * np.abs(away)
        usual = float(np.partition(off, len(off) // 2)[len(off) // 2])
        # Geman and McClure's weights.
        weight = 1 / (1 + (off / max(1.5 * usual, 0.3)) ** 2) ** 2
    return np.asarray(found / scale ** np.arange(degree + 1))
