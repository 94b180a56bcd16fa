"""Relief from an image: its high ground, and the depth of each place within it."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import PageError, require_within
from smarttouch.texture.grain import dominant_pitch_mm
from smarttouch.texture.relief_file import Heights
from smarttouch.texture.texture import COARSEST_PITCH_MM, FINEST_PITCH_MM, Texture, TextureSampler

USUAL_GRAIN_MM = 2.0
"""Default grain, where no pitch dominates: that of the paper's electrodes."""
_PER_GRAIN = 20
"""Pixels of the map per grain."""
_FINEST_MM, _COARSEST_MM = 0.02, 0.1
_MOST_PIXELS = 16_000_000
_LONGEST_SIDE = 32_000
"""Longest side of a map: OpenCV's sampling counts pixels in 16 bits."""
_LOWEST, _HIGHEST = 0.25, 0.75
"""Heights of shapes that are never and always high; between, the surroundings decide."""
_FAINT = 0.03
"""Least height of a ridge over its surroundings; the grain of an image is below it."""
_AROUND = 2.5
"""Width of the surroundings, in grains; their standard deviation is one grain."""
_BLUR_MM = 0.2
"""Blur against the noise of photographs of shapes; a line half as wide is still high."""


class Relief(Texture):
    """Heights on a map, and the depth of each place within high ground.

    `height` is (H, W) in [0, 1]; `depth`, (H, W) mm, the distance to where the high ground ends, at
    most half a grain; `woven` whether a pitch dominates; `pixel_mm` the pitch of the maps.
    """

    def __init__(
        self,
        heights: Heights,  # heights, drawn dark where high
        # way between two pulses on wide high ground; the dominant pitch if not given, and 2 mm if
        # there is none
        grain_mm: float | None = None,
        tiled: bool = False,  # repeat it without end
        inverted: bool = False,  # turn high and low
    ) -> None:
        rows, columns = heights.height.shape
        wide_mm, high_mm = columns * heights.mm_per_pixel, rows * heights.mm_per_pixel
        size_mm = None if tiled else (wide_mm, high_mm)
        super().__init__(heights.title, size_mm, (wide_mm / 2, high_mm / 2))
        self.tiled = tiled
        height = 1 - heights.height if inverted else heights.height
        pitch_mm = dominant_pitch_mm(height, heights.mm_per_pixel) if heights.photo else None
        self.woven = pitch_mm is not None
        if grain_mm is None:
            grain_mm = pitch_mm
            if grain_mm is not None:
                self.notes.append(
                    f"{heights.title}: ridges were found {grain_mm:.2g} mm apart, and wide ground "
                    "pulses as often unless a grain is given"
                )
            grain_mm = min(max(grain_mm or USUAL_GRAIN_MM, FINEST_PITCH_MM), COARSEST_PITCH_MM)
        words = f"a grain of {grain_mm:g} mm"
        require_within(PageError, "grain_mm", grain_mm, FINEST_PITCH_MM, COARSEST_PITCH_MM, words)
        self.grain_mm = grain_mm
        pixel_mm = min(max(grain_mm / _PER_GRAIN, _FINEST_MM), _COARSEST_MM)
        pixel_mm = max(
            pixel_mm,
            math.sqrt(wide_mm * high_mm / _MOST_PIXELS),
            max(wide_mm, high_mm) / _LONGEST_SIDE,
        )
        size = (max(2, round(wide_mm / pixel_mm)), max(2, round(high_mm / pixel_mm)))
        # Where a tile is no whole number of pixels, it is stretched a little.
        self.scale_mm = (wide_mm / size[0], high_mm / size[1])
        self.pixel_mm = max(self.scale_mm)
        method = cv2.INTER_AREA if size[0] <= columns else cv2.INTER_LINEAR
        self.height = np.asarray(cv2.resize(height, size, interpolation=method), np.float32)
        self.depth = self._measure_depth()
        self._surface = np.asarray(np.rint(255 * (1 - self.height)), np.uint8)

    def feeler(self, position_mm: NDArray[np.float64]) -> TextureSampler:
        """Return a sampler of electrodes over it."""
        from smarttouch.texture.relief_feeler import ReliefFeeler

        return ReliefFeeler(self, position_mm)

    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of it as ink on paper, (H, W) uint8."""
        by_x, by_y = pixel_mm / self.scale_mm[0], pixel_mm / self.scale_mm[1]
        left, top = left_mm / self.scale_mm[0], top_mm / self.scale_mm[1]
        if self.tiled:
            left, top = left % self._surface.shape[1], top % self._surface.shape[0]
        to_map = np.array([[by_x, 0, left + by_x / 2 - 0.5], [0, by_y, top + by_y / 2 - 0.5]])
        drawn = cv2.warpAffine(
            self._surface,
            to_map,
            shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP if self.tiled else cv2.BORDER_CONSTANT,
            borderValue=255,
        )
        return np.asarray(drawn, np.uint8)

    def _measure_depth(self) -> NDArray[np.float32]:
        """Return the depth of each place within high ground, mm, at most half a grain."""
        half = self.grain_mm / 2
        margin = math.ceil(_AROUND * self.grain_mm / self.pixel_mm)
        mode = cv2.BORDER_WRAP if self.tiled else cv2.BORDER_REPLICATE
        # What is beyond an edge is low, but the surroundings there are as at the edge.
        wide = cv2.copyMakeBorder(self.height, *(margin,) * 4, mode)
        # Twice a mean over a square is nearly a Gaussian, and takes no longer where it is wide.
        side = 2 * round(_AROUND * self.grain_mm / self.pixel_mm / 2) + 1
        around = cv2.blur(cv2.blur(wide, (side, side)), (side, side))
        blur_mm = self.grain_mm / 8 if self.woven else min(self.grain_mm / 10, _BLUR_MM)
        wide = cv2.GaussianBlur(wide, (0, 0), blur_mm / self.pixel_mm)
        if self.woven:
            threshold = np.minimum(around + _FAINT, _HIGHEST)
        else:
            threshold = np.clip(around, _LOWEST, _HIGHEST)
        high = np.asarray(wide > threshold, np.uint8)
        if not self.tiled:
            kept = np.zeros_like(high)
            inside = (slice(margin, -margin), slice(margin, -margin))
            kept[inside] = high[inside]
            high = kept
        depth = cv2.distanceTransform(high, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * self.pixel_mm
        depth = cv2.GaussianBlur(np.minimum(depth, half), (0, 0), 1.0)
        return np.asarray(depth[margin:-margin, margin:-margin].copy(), np.float32)
