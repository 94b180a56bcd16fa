"""Shift and turn between two images, to a part of a pixel.

Correlation finds the shift; Gauss–Newton steps on the grey levels refine it
(inverse compositional: Baker and Matthews, Lucas-Kanade 20 Years On, 2004).
"""

import math

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
_PROMISING = 0.5  # least correlation at which no other shift is looked for
_STEPS = 6
_CLOSE = 0.02  # length of a step, in pixels, below which the iteration ends
_LONGEST_STEP = 4.0
_LEAST_OVERLAP = 0.5  # least share of either side common to two images: a longer jump is rejected
_FEWEST_COMMON = 2
_FEWEST_PIXELS = 4
_NOISE = 4.0  # variance of a sensor's noise, levels²
_MOST_TURN_RAD = 0.1  # largest turn from image to image
_COARSER = 2

Image = NDArray[np.float32]
Floats = NDArray[np.float64]
Shift = tuple[float, float]  # shift to the right and down
Common = tuple[slice, slice]


class Matcher:
    """Finds shift and turn between an image and the one before, in pixels of the working image."""

    def __init__(self, shape: tuple[int, int]) -> None:
        small = max(shape) * FINER <= MOST_PIXELS
        scale = FINER if small else min(1.0, MOST_PIXELS / max(shape))
        rows, columns = (max(1, round(side * scale)) for side in shape)
        self.shape: tuple[int, int] = (rows, columns)
        self._method = cv2.INTER_CUBIC if small else cv2.INTER_AREA
        self._least_slope = LEAST_SLOPE / FINER**2 if small else LEAST_SLOPE
        self._seen = min(self.shape) // _COARSER >= _FEWEST_PIXELS
        self._before = self._image = np.zeros(self.shape, np.float32)
        self._middle = ((columns - 1) / 2, (rows - 1) / 2)
        self._beside = np.arange(columns, dtype=np.float32) - np.float32(self._middle[0])
        self._below = np.arange(rows, dtype=np.float32)[:, None] - np.float32(self._middle[1])
        self.turns = True  # whether turns are estimated
        self._usual: Shift = (0.0, 0.0)  # the last accepted shift: fingers move steadily

    def match(self, image: NDArray[np.uint8], first: bool) -> tuple[float, float, float]:
        """Return shift and turn of the content; zeros if unknown, or for a first image."""
        if image.shape != self.shape:
            size = self.shape[::-1]
            image = np.asarray(cv2.resize(image, size, interpolation=self._method), np.uint8)
        self._before, self._image = self._image, image.astype(np.float32)
        motion = None if first or not self._seen else self._find()
        if first or motion is not None:
            self._usual = motion[:2] if motion else (0.0, 0.0)
        return motion or (0.0, 0.0, 0.0)

    def _find(self) -> tuple[float, float, float] | None:
        """Return the shift and turn that explain the image; None if there are none."""
        begin = self._begin()
        common = None if begin is None else self._common(begin, 1)
        if begin is None or common is None:
            return None
        steep, slopes = self._slopes(common)
        if not len(steep):
            return None
        turns = self.turns and len(steep) == 2
        solve = np.linalg.pinv((slopes @ slopes.T).astype(np.float64), hermitian=True)
        shift, turn_rad = np.array(begin), 0.0
        rest, unexplained = self._rest(shift, turn_rad, common)
        for _ in range(_STEPS):
            step = solve @ (slopes @ rest)
            move, turn = step[: len(steep)] @ steep, step[2] if turns else 0.0
            shift, turn_rad = shift + move, turn_rad + turn
            length = math.hypot(*move)
            if length > _LONGEST_STEP or abs(turn_rad) > _MOST_TURN_RAD:
                return None
            rest, unexplained = self._rest(shift, turn_rad, common)
            if length + abs(turn) * max(self._middle) < _CLOSE:
                break
        if unexplained > MOST_UNEXPLAINED:
            return None
        # Only the part across print is known.
        x, y = (steep @ shift) @ steep
        return float(x), float(y), float(turn_rad)

    def _slopes(self, common: Common) -> tuple[Floats, Image]:
        """Return the directions in which the grey levels show a shift, (K, 2), and how the levels
        change with a shift in each, a turn if K is 2, and light, (K + 4 or K + 3, N)."""
        along_x, along_y = (
            np.asarray(cv2.Sobel(self._before, cv2.CV_32F, *way, ksize=3, scale=1 / 8)[common])
            for way in ((1, 0), (0, 1))
        )
        gradient = np.stack([along_x.ravel(), along_y.ravel()])
        squares, directions = np.linalg.eigh(np.cov(gradient, bias=True))
        steep = directions.T[squares > self._least_slope]
        beside, below = self._beside[common[1]], self._below[common[0]]
        level = self._before[common]
        # Light fixed to the sensor moves over the print, and must not be taken for motion.
        others = [level, level * beside, level * below]
        if self.turns and len(steep) == 2:
            others.insert(0, along_y * beside - along_x * below)
        slopes = np.vstack([steep @ gradient, [slope.ravel() for slope in others]])
        return steep, (slopes - slopes.mean(axis=1, keepdims=True)).astype(np.float32)

    def _rest(self, shift: Floats, turn_rad: float, common: Common) -> tuple[Image, float]:
        """Return the difference of the images there, (N,) levels, without its mean, and the share
        of their variance that it is."""
        cos, sin = math.cos(turn_rad), math.sin(turn_rad)
        x, y = self._middle
        to_now = np.array([
            [cos, -sin, shift[0] + x - cos * x + sin * y],
            [sin, cos, shift[1] + y - sin * x - cos * y],
        ])  # fmt: skip
        laid_back = cv2.warpAffine(
            self._image, to_now, self.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        before, now = self._before[common], np.asarray(laid_back, np.float32)[common]
        rest = (before - now).ravel()
        rest -= rest.mean()
        contrast = float(before.var() + now.var()) / 2
        return rest, float(rest @ rest) / rest.size / (contrast + _NOISE)

    def _begin(self) -> Shift | None:
        """Return the best of the usual shift, zero, and the peaks of two correlations."""
        (x, y), _ = cv2.phaseCorrelate(self._before, self._image)
        best = max((self._correlation(by), by) for by in {(x, y), self._usual, (0.0, 0.0)})
        if best[0] < _PROMISING:
            # Phase correlation weights all detail alike, and the finest of blurred print is noise.
            far = _largest_covariance(self._before, self._image)
            best = max(best, (self._correlation(far), far))
        return best[1] if best[0] > 0 else None

    def _correlation(self, shift: Shift) -> float:
        """Return the correlation at a shift in whole pixels; -1 if the overlap is too small."""
        common = self._common(shift)
        if common is None:
            return -1.0
        x, y = (round(by) for by in shift)
        rows, columns = common
        now = self._image[rows.start + y : rows.stop + y, columns.start + x : columns.stop + x]
        before = np.ascontiguousarray(self._before[common])
        correlation = cv2.matchTemplate(before, np.ascontiguousarray(now), cv2.TM_CCOEFF_NORMED)
        return float(correlation[0, 0])

    def _common(self, shift: Shift, border: int = 0) -> Common | None:
        """Return rows and columns of the image before that both show, without a border."""
        slices = []
        for side, by in zip(self.shape, map(round, shift[::-1]), strict=True):
            start, stop = border + max(0, -by), side - border - max(0, by)
            if abs(by) > (1 - _LEAST_OVERLAP) * side or stop - start < _FEWEST_COMMON:
                return None
            slices.append(slice(start, stop))
        rows, columns = slices
        return rows, columns


def _largest_covariance(before: Image, now: Image) -> Shift:
    """Return the shift, in whole pixels of the halved images, of the largest covariance."""
    rows, columns = (side // _COARSER for side in before.shape)
    first, second = (
        np.asarray(cv2.resize(levels, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
        for levels in (before, now)
    )
    down, across = rows // 2, columns // 2
    wide = np.pad(second - second.mean(), ((down, down), (across, across)))
    covariance = cv2.matchTemplate(wide, first - first.mean(), cv2.TM_CCORR)
    _, _, _, (x, y) = cv2.minMaxLoc(covariance)
    return float(_COARSER * (x - across)), float(_COARSER * (y - down))
