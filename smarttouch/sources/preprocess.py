"""Preprocessing of every incoming image: flat field, motion and pose."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError, SourceError
from smarttouch.base.files import MOST_ARRAY_BYTES, open_file
from smarttouch.profile import Optics, Profile
from smarttouch.sources.image_match import Matcher
from smarttouch.sources.source_contract import Pose

DEAD_SHARE = 0.25  # part of the median response to light below which a pixel is dead
HOT_LEVELS = 24.0  # grey levels above the median dark level from which a pixel is hot
LEAST_SPAN = 40.0  # least difference of white and dark, in grey levels
SATURATED = 254.0
MOST_SATURATED = 0.01
MOST_BROKEN = 0.02  # largest part of broken pixels


class FlatField:
    """Dark level and gain of every pixel, (H, W) float32; the gain of dead and hot ones is 0.

    Such a pixel shows the value of the nearest good one.
    """

    def __init__(self, dark: NDArray[np.float32], gain: NDArray[np.float32]) -> None:
        fits = dark.ndim == 2 and dark.shape == gain.shape and gain.any()
        if not (fits and np.isfinite([dark, gain]).all() and (gain >= 0).all()):
            raise SourceError(
                f"a dark level of shape {dark.shape} and a gain of shape {gain.shape} are no flat "
                "field, or hold no good pixel, or numbers that are negative or not finite: "
                "calibrate the optics again"
            )
        self.dark: NDArray[np.float32] = np.ascontiguousarray(dark, np.float32)
        self.gain: NDArray[np.float32] = np.ascontiguousarray(gain, np.float32)

    @property
    def broken(self) -> int:
        """Number of dead or hot pixels."""
        return int((self.gain == 0).sum())

    @cached_property
    def _stand_ins(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Broken pixels, and the nearest good one of each, as flat indices."""
        if not self.broken:
            none = np.empty(0, np.intp)
            return none, none
        # Slow to import, and few sensors have broken pixels.
        from scipy.ndimage import distance_transform_edt

        broken = self.gain == 0
        rows, columns = distance_transform_edt(broken, return_distances=False, return_indices=True)
        return np.flatnonzero(broken), (rows * self.gain.shape[1] + columns)[broken]

    def correct(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a corrected image, with the same response of every pixel."""
        if image.shape != self.gain.shape:
            (rows, columns), (height, width) = image.shape[:2], self.gain.shape
            raise SourceError(
                f"the flat field is for frames of {width} × {height}, this one has {columns} × "
                f"{rows}: calibrate the optics again, or remove optics.flat_field"
            )
        level = np.subtract(image, self.dark, dtype=np.float32)
        level *= self.gain
        level += 0.5
        np.clip(level, 0, 255, out=level)
        corrected = level.astype(np.uint8)
        broken, good = self._stand_ins
        if len(broken):
            corrected.ravel()[broken] = corrected.ravel()[good]
        return corrected

    @classmethod
    def measure(
        cls, dark_images: Sequence[NDArray[np.uint8]], white_images: Sequence[NDArray[np.uint8]]
    ) -> Self:
        """Return the flat field by images in the dark and of blank white paper.

        White stays as bright as it was on most pixels.
        """
        dark, white = mean_image(dark_images), mean_image(white_images)
        if dark.shape != white.shape:
            raise CalibrationError(
                f"the dark frames are {dark.shape[1]} × {dark.shape[0]}, the white ones "
                f"{white.shape[1]} × {white.shape[0]}: use one source for both"
            )
        span = white - dark
        usual = float(np.median(span))
        if usual < LEAST_SPAN:
            raise CalibrationError(
                f"white is only {usual:.0f} grey levels brighter than dark, {LEAST_SPAN:.0f} are "
                "needed: is the light on, the sensor covered for the dark and on white paper "
                "after?"
            )
        saturated = float((white >= SATURATED).mean())
        if saturated > MOST_SATURATED:
            raise CalibrationError(
                f"{saturated:.0%} of the pixels are saturated on white paper: lower the exposure "
                "or the light"
            )
        broken = (span < DEAD_SHARE * usual) | (dark > np.median(dark) + HOT_LEVELS)
        if broken.mean() > MOST_BROKEN:
            raise CalibrationError(
                f"{int(broken.sum())} of {broken.size} pixels are dead or hot: is the field of "
                "view free, lit evenly enough and really dark when covered?"
            )
        level = float(np.median(white[~broken]))
        gain = np.where(broken, 0.0, level / np.where(broken, 1.0, span))
        return cls(dark.astype(np.float32), gain.astype(np.float32))

    def to_bytes(self) -> bytes:
        """Return the flat field as the bytes of its file."""
        file = BytesIO()
        np.savez_compressed(file, dark=self.dark, gain=self.gain)
        return file.getvalue()

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the flat field of a file."""
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
                # A damaged archive fails in a dozen ways, down to those of its compression.
                raise SourceError(
                    f"{path} is not a flat field: calibrate the optics again, or remove "
                    "optics.flat_field"
                ) from None
        return cls(dark, gain)


def mean_image(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Return the mean of images of one shape."""
    if not len(images):
        raise CalibrationError("no frames arrived: check the source")
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        raise CalibrationError(f"the frames differ in shape, {sorted(shapes)}: use one source")
    total = np.zeros(images[0].shape)
    for image in images:
        total += image
    return total / len(images)


_SQUARE = 1.03  # ratio of the sides of pixels below which they are square


def page_per_pixel(optics: Optics, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the motion on the page that shifts the image by one pixel, (2, 2) mm.

    ``shape`` is that of the image that spans the field of view; a homography counts as in its
    middle.
    """
    rows, columns = shape
    if optics.homography is None:
        turn = math.radians(optics.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        pixel_mm = optics.field_width_mm / columns, optics.field_height_mm / rows
        # From image to page: the transpose of the turn in imaging.registration.
        return np.array([[cos, sin], [-sin, cos]]) * pixel_mm
    to_pixel = np.reshape(optics.homography, (3, 3))
    middle = to_pixel[:2, 2] / to_pixel[2, 2]
    slope = (to_pixel[:2, :2] - np.outer(middle, to_pixel[2, :2])) / to_pixel[2, 2]
    slope *= np.array([[columns / optics.sensor_columns], [rows / optics.sensor_rows]])
    return np.asarray(np.linalg.inv(slope))


def _is_even(page_mm: NDArray[np.float64]) -> bool:
    """Return whether pixels are square on the page, so that a turn of it is one of the image."""
    across, down = page_mm.T
    lengths = math.hypot(*across), math.hypot(*down)
    askew = abs(float(across @ down)) / (lengths[0] * lengths[1])
    return max(lengths) < _SQUARE * min(lengths) and askew < _SQUARE - 1


class FramePreprocessor:
    """Corrects images by the profile's flat field, and sums the motion between them to a pose.

    Motion that cannot be measured counts as none: on blank paper, along a straight edge that fills
    the patch, or where two images have too little in common.
    """

    def __init__(self, profile: Profile) -> None:
        self._correct: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None
        if profile.optics.flat_field is not None:
            flat_field = FlatField.load(Path(profile.optics.flat_field))
            # The first call may import scipy, which must not delay the first image of a run.
            flat_field.correct(np.zeros(flat_field.gain.shape, np.uint8))
            self._correct = flat_field.correct
        self._optics = profile.optics
        self._matcher: Matcher | None = None
        self._shape: tuple[int, ...] = ()
        self._page_mm = np.zeros((2, 2))
        self._is_first = True
        self._x_mm = self._y_mm = self._angle_rad = 0.0

    def take(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Pose]:
        """Return the corrected image, and its pose."""
        if self._correct is not None:
            image = self._correct(image)
        x_mm, y_mm, turn_rad = self.follow(image)
        self._angle_rad += turn_rad
        cos, sin = math.cos(self._angle_rad), math.sin(self._angle_rad)
        self._x_mm += cos * x_mm - sin * y_mm
        self._y_mm += sin * x_mm + cos * y_mm
        return image, Pose(self._x_mm, self._y_mm, self._angle_rad)

    def follow(self, image: NDArray[np.uint8]) -> tuple[float, float, float]:
        """Return the motion of the patch on the page since the last image: mm along its rows and
        columns, and its turn in radians.

        When the print moves left in the image, the patch has moved right. An image of another size
        starts again.
        """
        if self._matcher is None or image.shape != self._shape:
            self._shape = image.shape
            self._matcher = Matcher((image.shape[0], image.shape[1]))
            self._page_mm = page_per_pixel(self._optics, self._matcher.shape)
            self._matcher.turns = _is_even(self._page_mm)
            self._is_first = True
        x, y, turn_rad = self._matcher.match(image, self._is_first)
        self._is_first = False
        x_mm, y_mm = (-self._page_mm @ (x, y)).tolist()
        return x_mm, y_mm, -turn_rad

    def interrupt(self) -> None:
        """Ignore the motion to the next image, after an unknown time."""
        self._is_first = True
