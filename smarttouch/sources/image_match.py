"""Shift and turn between two images, to a part of a pixel.

Phase correlation finds the shift; Gauss–Newton steps on the grey levels refine it
(inverse compositional: Baker and Matthews, Lucas-Kanade 20 Years On, 2004).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_PIXELS = 64
"""Longest side; larger images are reduced: more pixels cost time and add little accuracy."""
FINER = 2
"""Images of half that or less are enlarged so much: linear interpolation between their own pixels
costs 16 x 16 sensors four fifths of the accuracy."""
LEAST_SLOPE = 6.0
"""Mean square of the grey levels' slope, (levels/pixel)², below which a direction shows no print:
noise of 2 levels and uneven light make some 1.5."""
MOST_UNEXPLAINED = 0.25  # share of the grey levels' variance that the shift may leave unexplained
_PROMISING = 0.5  # largest such share before the shift is refined
_STEPS = 4
_CLOSE = 0.02  # length of a step, in pixels, below which the iteration ends
_LONGEST_STEP = 2.0
_LEAST_OVERLAP = 0.5  # least share of either side common to two images: a longer jump is rejected
_FEWEST_COMMON = 2
_FEWEST_PIXELS = 4
_NOISE = 4.0  # variance of a sensor's noise, levels²

_NEARLY = 1.05
"""Ratio of what trials leave unexplained below which both are as good: light adds to it."""
_MOST_TURN_RAD = 0.1  # largest turn from image to image
_COARSER = 2

Image = NDArray[np.float32]
Shift = tuple[float, float]  # shift to the right and down
Correlation = Callable[[Image, Image], Shift]


class _Trial(NamedTuple):
    """Overlap of the shifted and turned image with the one before."""

    shift: Shift
    turn_rad: float
    common: tuple[slice, slice]
    rest: Image  # difference, (N,) levels, without its mean: light may change
    unexplained: float


class Matcher:
    """Finds shift and turn between an image and the one before, in pixels of the working image."""

    def __init__(self, shape: tuple[int, int]) -> None:
        small = max(shape) * FINER <= MOST_PIXELS
        scale = FINER if small else min(1.0, MOST_PIXELS / max(shape))
        rows, columns = (max(1, round(side * scale)) for side in shape)
        self.shape: tuple[int, int] = (rows, columns)
        self._method = cv2.INTER_CUBIC if small else cv2.INTER_AREA
        self._least_slope = LEAST_SLOPE / FINER**2 if small else LEAST_SLOPE
        self._native = FINER if small else 1
        self._seen = min(self.shape) // _COARSER >= _FEWEST_PIXELS
        self._working = np.empty(self.shape, np.uint8)
        self._image, self._before, self._laid_back, self._slope_x, self._slope_y = (
            np.zeros(self.shape, np.float32) for _ in range(5)
        )
        self._to = np.eye(2, 3, dtype=np.float32)
        self._middle = ((columns - 1) / 2, (rows - 1) / 2)
        self._beside = np.arange(columns, dtype=np.float32) - np.float32(self._middle[0])
        self._below = np.arange(rows, dtype=np.float32)[:, None] - np.float32(self._middle[1])
        self.turns = True  # whether turns are estimated
        self._usual: Shift = (0.0, 0.0)  # the last accepted shift: fingers move steadily

    def match(self, image: NDArray[np.uint8], first: bool) -> tuple[float, float, float]:
        """Return shift and turn of the content; zeros if unknown, or for a first image."""
        if image.shape != self.shape:
            size = self.shape[::-1]
            cv2.resize(image, size, dst=self._working, interpolation=self._method)
            image = self._working
        self._image[:] = image
        found = None if first else self._find()
        shift, turn_rad = found or ((0.0, 0.0), 0.0)
        if first or found is not None:
            self._usual = shift
        self._image, self._before = self._before, self._image
        cv2.Sobel(self._before, cv2.CV_32F, 1, 0, dst=self._slope_x, ksize=3, scale=1 / 8)
        cv2.Sobel(self._before, cv2.CV_32F, 0, 1, dst=self._slope_y, ksize=3, scale=1 / 8)
        return *shift, turn_rad

    def _find(self) -> tuple[Shift, float] | None:
        """Return the shift and turn that explain the image; None if there are none."""
        best = self._begin() if self._seen else None
        if best is None:
            return None
        slopes = _Slopes(self._slope_x[best.common], self._slope_y[best.common], self._least_slope)
        for _ in range(_STEPS):
            step = slopes.solve(best.rest)
            length = math.hypot(*step)
            if length > _LONGEST_STEP:
                break
            trial = self._try((best.shift[0] + step[0], best.shift[1] + step[1]), best.common)
            if trial is None or trial.unexplained >= best.unexplained:
                break
            best = trial
            if length < _CLOSE:
                break
        turned = self._turned(best) if self.turns and slopes.whole else None
        if turned is not None and turned.unexplained <= MOST_UNEXPLAINED:
            return turned.shift, turned.turn_rad
        along = slopes.along(best.shift) if best.unexplained <= MOST_UNEXPLAINED else None
        return None if along is None else (along, 0.0)

    def _turned(self, best: _Trial) -> _Trial | None:
        """Return a better trial with a turn; None if there is none."""
        rows, columns = best.common
        slope_x, slope_y = self._slope_x[best.common], self._slope_y[best.common]
        turning = slope_y * self._beside[columns] - slope_x * self._below[rows]
        # Light fixed to the sensor moves over the print, and must not be taken for a turn.
        level = self._before[best.common]
        lights = level, level * self._beside[columns], level * self._below[rows]
        slopes = np.stack([each.ravel() for each in (slope_x, slope_y, turning, *lights)])
        slopes -= slopes.mean(axis=1, keepdims=True)
        try:
            inverse = np.linalg.inv(slopes @ slopes.T)
        except np.linalg.LinAlgError:
            return None
        found = None
        for _ in range(_STEPS):
            x, y, turn_rad = (inverse @ (slopes @ best.rest))[:3].tolist()
            shift = best.shift[0] + x, best.shift[1] + y
            if math.hypot(x, y) > _LONGEST_STEP or abs(best.turn_rad + turn_rad) > _MOST_TURN_RAD:
                break
            trial = self._try(shift, best.common, best.turn_rad + turn_rad)
            if trial is None or trial.unexplained > _NEARLY * best.unexplained:
                break
            best = found = trial
            if math.hypot(x, y) + abs(turn_rad) * max(self._middle) < _CLOSE:
                break
        return found

    def _begin(self) -> _Trial | None:
        """Return the best of the usual shift, zero, and the peak of the correlation."""
        phase = self._correlate(_phase_correlation, self._native)
        best = self._best({phase, self._usual, (0.0, 0.0)})
        if best is not None and best.unexplained <= _PROMISING:
            return best
        # Phase correlation weights all detail alike, and the finest of blurred print is noise.
        return self._best({self._correlate(_correlation, _COARSER)}) or best

    def _best(self, shifts: set[Shift]) -> _Trial | None:
        trials = [trial for shift in shifts if (trial := self._try(shift)) is not None]
        return min(trials, key=lambda trial: trial.unexplained, default=None)

    def _correlate(self, method: Correlation, reduction: int) -> Shift:
        rows, columns = (max(1, side // reduction) for side in self.shape)
        before, now = (
            np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
            for image in (self._before, self._image)
        )
        x, y = method(before, now)
        return x * self.shape[1] / columns, y * self.shape[0] / rows

    def _try(
        self, shift: Shift, common: tuple[slice, slice] | None = None, turn_rad: float = 0.0
    ) -> _Trial | None:
        """Return the overlap at a shift and turn; None if it is too small."""
        common = common or self._common(shift)
        if common is None:
            return None
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        x, y = self._middle
        self._to[0] = cos, -sin, shift[0] + x - cos * x + sin * y
        self._to[1] = sin, cos, shift[1] + y - sin * x - cos * y
        cv2.warpAffine(
            self._image, self._to, self.shape[::-1], dst=self._laid_back,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        before, now = self._before[common], self._laid_back[common]
        rest = np.asarray(cv2.subtract(before, now), np.float32).ravel()
        rest -= np.float32(cv2.mean(rest)[0])
        contrast = (_deviation(before) ** 2 + _deviation(now) ** 2) / 2
        return _Trial(
            shift, turn_rad, common, rest, float(rest @ rest) / rest.size / (contrast + _NOISE)
        )

    def _common(self, shift: Shift) -> tuple[slice, slice] | None:
        """Return the rows and columns common to both images, without the outermost."""
        slices = []
        for side, by in zip(self.shape, shift[::-1], strict=True):
            if not abs(by) <= (1 - _LEAST_OVERLAP) * side:
                return None
            start, stop = 1 + max(0, math.ceil(-by)), side - 1 - max(0, math.ceil(by))
            if stop - start < _FEWEST_COMMON:
                return None
            slices.append(slice(start, stop))
        rows, columns = slices
        return rows, columns


def _phase_correlation(before: Image, now: Image) -> Shift:
    (x, y), _ = cv2.phaseCorrelate(before, now)
    return x, y


def _correlation(before: Image, now: Image) -> Shift:
    """Return the shift, in whole pixels, of the largest covariance of the overlap."""
    rows, columns = before.shape
    size = (2 * rows, 2 * columns)
    one, first, second = (
        np.fft.rfft2(levels, size)
        for levels in (np.ones_like(now), before - before.mean(), now - now.mean())
    )
    common = np.fft.irfft2(one.conj() * one, size)
    covariance = np.fft.irfft2(first.conj() * second, size)
    covariance /= np.maximum(common, _LEAST_OVERLAP**2 * rows * columns)
    y, x = divmod(int(covariance.argmax()), size[1])
    return float((x + columns) % size[1] - columns), float((y + rows) % size[0] - rows)


def _deviation(levels: Image) -> float:
    return float(cv2.meanStdDev(levels)[1][0, 0])


class _Slopes:
    """Slopes of the grey levels, and the directions in which they show a shift."""

    def __init__(self, slope_x: Image, slope_y: Image, least: float) -> None:
        slopes = np.stack([slope_x.ravel(), slope_y.ravel()])
        slopes -= slopes.mean(axis=1, keepdims=True)
        self._slopes = slopes
        (xx, xy), (_, yy) = (slopes @ slopes.T).tolist()
        turn = math.atan2(2 * xy, xx - yy) / 2
        cos, sin = math.cos(turn), math.sin(turn)
        middle, spread = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
        steep = (((cos, sin), middle + spread), ((-sin, cos), middle - spread))
        self._steep = [
            (direction, sum_) for direction, sum_ in steep if sum_ > least * slopes.shape[1]
        ]

    @property
    def whole(self) -> bool:
        """Whether they show a shift in any direction."""
        return len(self._steep) == 2

    def solve(self, rest: Image) -> Shift:
        """Return the step that would explain ``rest``, where the slopes are steep enough."""
        by_x, by_y = (self._slopes @ rest).tolist()
        x = y = 0.0
        for (cos, sin), sum_ in self._steep:
            length = (cos * by_x + sin * by_y) / sum_
            x += cos * length
            y += sin * length
        return x, y

    def along(self, shift: Shift) -> Shift | None:
        """Return the measurable part of a shift; None if there is none."""
        if not self._steep:
            return None
        x = y = 0.0
        for (cos, sin), _ in self._steep:
            length = cos * shift[0] + sin * shift[1]
            x += cos * length
            y += sin * length
        return x, y
