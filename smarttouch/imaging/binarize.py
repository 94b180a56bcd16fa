"""Binarization: a threshold between ink and paper that ignores blank paper."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

CONTRAST_GUARD = 45.0
"""Least contrast of print: grey levels of its darkest part below the white."""
GREY_GUARD = 0.41
"""Largest part of intermediate grey levels in print; more of them are noise."""
INK_LEVEL = 0.7
"""Part of the white below which is ink."""
WHITE_DECAY_PER_S = 0.8
"""Rate at which the tracked white may fall: slow enough to cross a black headline."""
GREY_PRINT = 0.55
"""Part of the white above which the darkest is grey print, or a shadow, and no black."""
FAINT_PART = 0.11
"""Least contrast of faint print, of the white."""
FAINT_GRAINS = 4.0
"""Least contrast of faint print, in the usual depth of the paper's grain."""
_FAINT_RANKS = np.array([0.5, 0.97])
"""Parts of a patch of faint print that are no deeper than grain, and than its ink."""
_WINDOW = 4
"""Windows of paper across a patch: strokes of text are narrower."""
AREA_PART = 0.5
"""Part of the patch across which an area is dark that is wider than any usual stroke."""
BLACK_AREA = 0.2
"""Part of the white above which such an area is a table, a picture or a deep shadow, no ink."""
_MUCH = 0.25
"""Dark part of a patch from which it is searched for such areas."""
_BESIDE = 2
"""Samples around them that are blurred."""
_SAMPLES = 32
"""Rows and columns of the sample for the guards."""


class Binarizer:
    """Separates ink from paper, frame after frame of one shape.

    A threshold taken from each frame by itself (Otsu's) must call something ink even on blank
    paper. Here the white of the paper is tracked from frame to frame, ink is what is darker than a
    fixed part of it, and two guards keep the whole patch silent: the darkest part must differ from
    the white, and most of the patch must be one or the other; print below that contrast must stand
    out from the grain of the paper beside it. Areas wider than strokes that are not black are no
    ink, but what a sheet lies on. Seen through a 5 mm patch, 1 in 100 places of a photographed page
    has more than 0.37 of its area in between; dense noise of any grain has 0.43 and more.
    """

    def __init__(self, shape: tuple[int, int], light_on_dark: bool = False) -> None:
        self._inverted = np.empty(shape, np.uint8) if light_on_dark else None
        self._smooth = np.empty(shape, np.uint8)
        self._ink = np.empty(shape, np.uint8)
        down, across = (max(1, side // _SAMPLES) for side in shape)
        self._sample = self._smooth[::down, ::across]
        side = max(3, min(self._sample.shape) // _WINDOW) | 1
        self._window = np.ones((side, side), np.uint8)
        area = max(3, round(AREA_PART * min(self._sample.shape))) | 1
        self._area = np.ones((area, area), np.uint8)
        self._around = np.ones((area + 2 * _BESIDE, area + 2 * _BESIDE), np.uint8)
        self._levels = np.empty(self._sample.shape, np.intp)
        count = self._sample.size
        # Of the darkest and of the brightest.
        self._ranks = np.array([int(0.02 * count), int(0.95 * count)])
        self._white = self._paper = 0.0
        self._time_ns = 0

    def ink(self, image: NDArray[np.uint8], time_ns: int, touching: bool) -> NDArray[np.uint8]:
        """Return 255 where an image, (H, W), has ink, else 0; overwritten by the next call.

        A lifted finger may land anywhere: its white is that of the frame.
        """
        if self._inverted is not None:
            image = np.asarray(cv2.bitwise_not(image, dst=self._inverted), np.uint8)
        smooth = self._smooth
        cv2.blur(image, (3, 3), dst=smooth)
        # Counts of all that is no brighter: quicker than sorting, and as good.
        np.copyto(self._levels, self._sample)
        counts = np.bincount(self._levels.reshape(-1), minlength=256).cumsum()
        dark, bright = counts.searchsorted(self._ranks, "right").tolist()
        elapsed_s = max(0, time_ns - self._time_ns) / 1e9
        self._time_ns = time_ns
        floor = self._white * math.exp(-WHITE_DECAY_PER_S * elapsed_s) if touching else 0.0
        white = self._white = max(bright, floor)
        if bright >= floor:
            self._paper = white
        # Those in the middle four tenths of the range.
        low = math.ceil(dark + 0.3 * (bright - dark))
        high = math.ceil(dark + 0.7 * (bright - dark))
        count = counts.item
        between = (count(high - 1) if high else 0) - (count(low - 1) if low else 0)
        if white - dark < CONTRAST_GUARD or dark > GREY_PRINT * white:
            return self._faint_ink(white)
        if between / count(-1) > GREY_GUARD:
            self._ink.fill(0)
            return self._ink
        cv2.threshold(smooth, INK_LEVEL * white, 255, cv2.THRESH_BINARY_INV, dst=self._ink)
        if count(int(INK_LEVEL * white)) > _MUCH * count(-1):
            self._leave_out_areas(white)
        return self._ink

    def _leave_out_areas(self, white: float) -> None:
        """Remove areas that are wider than strokes from the ink, unless they are black."""
        dark = (self._sample < INK_LEVEL * white).view(np.uint8)
        areas = np.asarray(cv2.dilate(cv2.erode(dark, self._area), self._around), np.uint8)
        if areas.any() and cv2.mean(self._sample, areas & dark)[0] > BLACK_AREA * self._paper:
            wide = cv2.resize(areas, self._ink.shape[::-1], interpolation=cv2.INTER_NEAREST)
            cv2.subtract(self._ink, wide * np.uint8(255), dst=self._ink)

    def _faint_ink(self, white: float) -> NDArray[np.uint8]:
        """Return the ink of faint print, darker than the paper: the patch without narrow spots, so
        that uneven light is no ink. The paper's own unevenness is its grain."""
        paper = cv2.morphologyEx(self._sample, cv2.MORPH_CLOSE, self._window)
        depths = np.bincount(cv2.subtract(paper, self._sample).reshape(-1), minlength=256).cumsum()
        grain, deep = depths.searchsorted(depths[-1] * _FAINT_RANKS, "right").tolist()
        if deep < max(FAINT_PART * white, FAINT_GRAINS * max(grain, 1)):
            self._ink.fill(0)
            return self._ink
        wide = cv2.resize(paper, self._smooth.shape[::-1], interpolation=cv2.INTER_LINEAR)
        depth = cv2.subtract(wide, self._smooth)
        cv2.threshold(depth, deep / 2, 255, cv2.THRESH_BINARY, dst=self._ink)
        return self._ink
