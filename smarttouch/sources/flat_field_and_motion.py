"""Preprocessing of camera images: flat-field correction, motion between images, and pose."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError, SourceError
from smarttouch.base.files import MOST_ARRAY_BYTES, open_file
from smarttouch.profile import Optics, Profile
from smarttouch.sources.source_contract import Pose

DEAD_SHARE = 0.25  # a pixel is dead if its response to light is below this share of the median
HOT_LEVELS = 24.0  # a pixel is hot if its dark level is this many gray levels above the median
LEAST_SPAN = 40.0  # smallest difference between the gray levels of white paper and darkness
SATURATED = 254.0
MOST_SATURATED = 0.01
MOST_BROKEN = 0.02  # largest accepted share of dead or hot pixels


class FlatField:
    """Dark level and gain of each pixel, (H, W) float32. The gain of dead and hot pixels is 0;
    these pixels get the median of their neighbors."""

    def __init__(self, dark: NDArray[np.float32], gain: NDArray[np.float32]) -> None:
        fits = dark.ndim == 2 and dark.shape == gain.shape and gain.any()
        if not (fits and np.isfinite([dark, gain]).all() and (gain >= 0).all()):
            raise SourceError(
                f"the flat field is damaged (shapes {dark.shape} and {gain.shape}, or numbers that "
                "are negative, not finite or all 0): calibrate the optics again"
            )
        self.dark: NDArray[np.float32] = np.ascontiguousarray(dark, np.float32)
        self.gain: NDArray[np.float32] = np.ascontiguousarray(gain, np.float32)

    @cached_property
    def broken(self) -> int:
        """Number of dead or hot pixels."""
        return int((self.gain == 0).sum())

    def correct(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image that a sensor with equal pixels would have taken."""
        if image.shape != self.gain.shape:
            (rows, columns), (height, width) = image.shape[:2], self.gain.shape
            raise SourceError(
                f"the flat field is for {width} × {height} pixels, but the frame has {columns} × "
                f"{rows}: calibrate the optics again, or remove optics.flat_field"
            )
        level = np.subtract(image, self.dark, dtype=np.float32)
        level *= self.gain
        level += 0.5
        np.clip(level, 0, 255, out=level)
        corrected = level.astype(np.uint8)
        if self.broken:
            np.copyto(corrected, cv2.medianBlur(corrected, 3), where=self.gain == 0)
        return corrected

    @classmethod
    def measure(
        cls, dark_images: Sequence[NDArray[np.uint8]], white_images: Sequence[NDArray[np.uint8]]
    ) -> Self:
        """Compute the flat field from images in the dark and images of blank white paper. The
        correction does not change the median level of white paper."""
        dark, white = mean_image(dark_images), mean_image(white_images)
        if dark.shape != white.shape:
            raise CalibrationError(
                f"the dark frames are {dark.shape[1]} × {dark.shape[0]}, but the white ones "
                f"{white.shape[1]} × {white.shape[0]}: use one source for both"
            )
        span = white - dark
        typical = float(np.median(span))
        if typical < LEAST_SPAN:
            raise CalibrationError(
                f"white is only {typical:.0f} gray levels above dark, but {LEAST_SPAN:.0f} are "
                "needed: cover the sensor for the dark frames; for the white frames, turn on the "
                "light and put the sensor on white paper"
            )
        saturated = float((white >= SATURATED).mean())
        if saturated > MOST_SATURATED:
            raise CalibrationError(
                f"{saturated:.0%} of the pixels are saturated on white paper: lower the exposure "
                "or the light"
            )
        broken = (span < DEAD_SHARE * typical) | (dark > np.median(dark) + HOT_LEVELS)
        if broken.mean() > MOST_BROKEN:
            raise CalibrationError(
                f"{int(broken.sum())} of {broken.size} pixels are dead or hot: check that the "
                "field of view is free, lit evenly, and dark when covered"
            )
        level = float(np.median(white[~broken]))
        gain = np.where(broken, 0.0, level / np.where(broken, 1.0, span))
        return cls(dark.astype(np.float32), gain.astype(np.float32))

    def to_bytes(self) -> bytes:
        """Return the content of a flat-field file."""
        file = BytesIO()
        np.savez_compressed(file, dark=self.dark, gain=self.gain)
        return file.getvalue()

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Load a flat field from a file."""
        if not Path(path).exists():
            message = (
                f"no flat field {path}: put it beside the profile, or remove optics.flat_field"
            )
            raise SourceError(message)
        with open_file(Path(path), SourceError, MOST_ARRAY_BYTES) as file:
            try:
                stored = np.load(file, allow_pickle=False)
                dark, gain = (np.asarray(stored[name], np.float32) for name in ("dark", "gain"))
            except Exception:
                # A damaged archive can raise many errors.
                raise SourceError(
                    f"{path} is not a flat field: calibrate the optics again, or remove "
                    "optics.flat_field"
                ) from None
        return cls(dark, gain)


def mean_image(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Return the mean of images, which must have the same shape."""
    if not len(images):
        raise CalibrationError("no frames arrived: check the source")
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        raise CalibrationError(f"the frames differ in shape, {sorted(shapes)}: use one source")
    total = np.zeros(images[0].shape)
    for image in images:
        total += image
    return total / len(images)


MOST_PIXELS = 64
"""Longest side of the images that `Matcher` compares: more pixels add little accuracy."""
FINER = 2
"""Factor by which `Matcher` enlarges images, unless a side would exceed `MOST_PIXELS`. Without this
enlargement, the motion that a sensor of 16 x 16 pixels measures loses 80 % of its accuracy."""
LEAST_SLOPE = 6.0
"""A shift along a direction is visible if the mean squared gradient along the direction is above
this limit, (levels/pixel)². On blank paper, noise of 2 levels and uneven light cause about 1.5."""
MOST_UNEXPLAINED = 0.25  # a valid shift leaves at most this share of the variance unexplained
_STEPS = 6
_CLOSE = 0.02  # the iteration has converged if a step is below this, pixels
_LONGEST_STEP = 4.0
_LEAST_OVERLAP = 0.5  # smallest overlap of two images, as a fraction of the width and of the height
_FEWEST_COMMON = 2
_FEWEST_PIXELS = 4
_NOISE = 4.0  # variance of sensor noise, levels²
_COARSER = 2

Image = NDArray[np.float32]
Floats = NDArray[np.float64]
Shift = tuple[float, float]  # pixels right and down
Common = tuple[slice, slice]


class Matcher:
    """Estimator of the shift between successive images, in pixels of images resized to `shape`.

    Correlation finds the shift to one pixel. Gauss–Newton steps on gray levels refine it (inverse
    compositional algorithm: Baker and Matthews, Lucas-Kanade 20 Years On, 2004)."""

    def __init__(self, shape: tuple[int, int]) -> None:
        small = max(shape) * FINER <= MOST_PIXELS
        scale = FINER if small else min(1.0, MOST_PIXELS / max(shape))
        rows, columns = (max(1, round(side * scale)) for side in shape)
        self.shape: tuple[int, int] = (rows, columns)
        self._method = cv2.INTER_CUBIC if small else cv2.INTER_AREA
        self._least_slope = LEAST_SLOPE / FINER**2 if small else LEAST_SLOPE
        self._seen = min(self.shape) // _COARSER >= _FEWEST_PIXELS
        self._before = self._image = np.zeros(self.shape, np.float32)
        self._beside = np.linspace(-1, 1, columns, dtype=np.float32)
        self._below = np.linspace(-1, 1, rows, dtype=np.float32)[:, None]
        self._last_shift: Shift = (0.0, 0.0)  # probable next shift, because fingers move steadily

    def match(self, image: NDArray[np.uint8], first: bool) -> Shift:
        """Return the shift of the content from the last image to this one. Return zeros if the
        shift is unknown or this is the ``first`` image."""
        if image.shape != self.shape:
            size = self.shape[::-1]
            image = np.asarray(cv2.resize(image, size, interpolation=self._method), np.uint8)
        self._before, self._image = self._image, image.astype(np.float32)
        shift = None if first or not self._seen else self._find()
        if first or shift is not None:
            self._last_shift = shift or (0.0, 0.0)
        return shift or (0.0, 0.0)

    def _find(self) -> Shift | None:
        """Return the shift from the last image to this one, or None if it is unknown."""
        begin = self._begin()
        common = None if begin is None else self._common(begin, 1)
        if begin is None or common is None:
            return None
        steep, slopes = self._slopes(common)
        if not len(steep):
            return None
        solve = np.linalg.pinv((slopes @ slopes.T).astype(np.float64), hermitian=True)
        shift = np.array(begin)
        rest, unexplained = self._rest(shift, common)
        for _ in range(_STEPS):
            step = (solve @ (slopes @ rest))[: len(steep)] @ steep
            shift, length = shift + step, math.hypot(*step)
            if length > _LONGEST_STEP:
                return None
            rest, unexplained = self._rest(shift, common)
            if length < _CLOSE:
                break
        if unexplained > MOST_UNEXPLAINED:
            return None
        # Motion along edges is invisible: keep only the shift across edges.
        x, y = (steep @ shift) @ steep
        return float(x), float(y)

    def _slopes(self, common: Common) -> tuple[Floats, Image]:
        """Return two arrays. The first, (K, 2), has the K directions in which a shift is visible.
        The second, (K + 3, N), has the derivatives of the gray levels of N pixels with respect to
        the shift in each direction (K rows) and the strengths of 3 patterns of light (3 rows)."""
        along_x, along_y = (
            np.asarray(cv2.Sobel(self._before, cv2.CV_32F, *way, ksize=3, scale=1 / 8)[common])
            for way in ((1, 0), (0, 1))
        )
        gradient = np.stack([along_x.ravel(), along_y.ravel()])
        squares, directions = np.linalg.eigh(np.cov(gradient, bias=True))
        steep = directions.T[squares > self._least_slope]
        level = self._before[common]
        # Light does not move with the page: model it, so it does not distort the measured motion.
        light = level, level * self._beside[common[1]], level * self._below[common[0]]
        slopes = np.vstack([steep @ gradient, [light_map.ravel() for light_map in light]])
        return steep, (slopes - slopes.mean(axis=1, keepdims=True)).astype(np.float32)

    def _rest(self, shift: Floats, common: Common) -> tuple[Image, float]:
        """Undo a shift. Return the remaining difference of the images minus its mean, (N,), in gray
        levels. Also return the variance of this difference, relative to that of the images."""
        to_now = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
        undone = cv2.warpAffine(
            self._image, to_now, self.shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        before, now = self._before[common], np.asarray(undone, np.float32)[common]
        rest = (before - now).ravel()
        rest -= rest.mean()
        contrast = float(before.var() + now.var()) / 2
        return rest, float(rest @ rest) / rest.size / (contrast + _NOISE)

    def _begin(self) -> Shift | None:
        """Return the shift at which iteration starts. The candidates are the last shift, zero, and
        the result of `_largest_covariance`. Return the candidate with the highest correlation, or
        None if no correlation is positive."""
        far = _largest_covariance(self._before, self._image)
        best = max((self._correlation(by), by) for by in {far, self._last_shift, (0.0, 0.0)})
        return best[1] if best[0] > 0 else None

    def _correlation(self, shift: Shift) -> float:
        """Return the correlation at an integer shift; -1 if the overlap is too small."""
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
        """Return the part of the last image that overlaps this image, without ``border`` pixels at
        each side: rows and columns of the last image. Return None if the overlap is too small."""
        slices = []
        for side, by in zip(self.shape, map(round, shift[::-1]), strict=True):
            start, stop = border + max(0, -by), side - border - max(0, by)
            if abs(by) > (1 - _LEAST_OVERLAP) * side or stop - start < _FEWEST_COMMON:
                return None
            slices.append(slice(start, stop))
        rows, columns = slices
        return rows, columns


def _largest_covariance(before: Image, now: Image) -> Shift:
    """Return the shift, in pixels, at which the covariance of the images is largest. The search
    uses images of half the size, so the shift is a multiple of 2."""
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


def page_per_pixel(optics: Optics, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the matrix, (2, 2), that converts a shift in pixels to a motion on the page in mm.

    ``shape`` is the shape of the image. A homography is linearized at the middle of the image.
    """
    rows, columns = shape
    if optics.homography is None:
        turn = math.radians(optics.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        pixel_mm = optics.field_width_mm / columns, optics.field_height_mm / rows
        # Image to page: the transpose of the rotation in imaging.registration.
        return np.array([[cos, sin], [-sin, cos]]) * pixel_mm
    to_pixel = np.reshape(optics.homography, (3, 3))
    middle = to_pixel[:2, 2] / to_pixel[2, 2]
    slope = (to_pixel[:2, :2] - np.outer(middle, to_pixel[2, :2])) / to_pixel[2, 2]
    slope *= np.array([[columns / optics.sensor_columns], [rows / optics.sensor_rows]])
    return np.asarray(np.linalg.inv(slope))


class FramePreprocessor:
    """Flat-field correction of successive images, and tracking of the sensor's pose.

    A motion counts as zero if it cannot be measured: on blank paper, along a straight edge that
    fills the image, or if two images overlap too little.
    """

    def __init__(self, profile: Profile) -> None:
        self._correct: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None
        if profile.optics.flat_field is not None:
            self._correct = FlatField.load(Path(profile.optics.flat_field)).correct
        self._optics = profile.optics
        self._matcher: Matcher | None = None
        self._shape: tuple[int, ...] = ()
        self._page_mm = np.zeros((2, 2))
        self._is_first = True
        self._x_mm = self._y_mm = 0.0

    def take(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Pose]:
        """Return the corrected image and its pose."""
        if self._correct is not None:
            image = self._correct(image)
        x_mm, y_mm = self.follow(image)
        self._x_mm += x_mm
        self._y_mm += y_mm
        return image, Pose(self._x_mm, self._y_mm)

    def follow(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """Return the motion of the sensor on the page since the last image, mm right and down.

        If print moves left in the image, the sensor has moved right. An image of another size
        restarts the measurement.
        """
        if self._matcher is None or image.shape != self._shape:
            self._shape = image.shape
            self._matcher = Matcher((image.shape[0], image.shape[1]))
            self._page_mm = page_per_pixel(self._optics, self._matcher.shape)
            self._is_first = True
        shift = self._matcher.match(image, self._is_first)
        self._is_first = False
        x_mm, y_mm = (-self._page_mm @ shift).tolist()
        return x_mm, y_mm

    def interrupt(self) -> None:
        """Do not measure the motion from the last image to the next one."""
        self._is_first = True
