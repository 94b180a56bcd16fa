"""Flat field: dark level and gain of every pixel, by which blank paper becomes uniform."""

from collections.abc import Sequence
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.arrays import read_arrays
from smarttouch.errors import CalibrationError, SourceError
from smarttouch.files import MOST_BANK_BYTES, open_file, write_bytes

DEAD_SHARE = 0.25
"""Part of the median response to light below which a pixel is dead."""
HOT_LEVELS = 24.0
"""Grey levels above the median dark level from which a pixel is hot."""
LEAST_SPAN = 40.0
"""Least difference of white and dark, in grey levels."""
SATURATED = 254.0
MOST_SATURATED = 0.01
MOST_BROKEN = 0.02
"""Largest part of broken pixels."""


class FlatField:
    """Dark level and gain of every pixel, (H, W) float32; the gain of dead and hot ones is 0.

    Such a pixel shows the value of the nearest good one.
    """

    def __init__(self, dark: NDArray[np.float32], gain: NDArray[np.float32]) -> None:
        if dark.ndim != 2 or dark.shape != gain.shape or not dark.size:
            raise _no_field(
                f"the dark level of shape {dark.shape} and the gain of shape {gain.shape} are no "
                "flat field: calibrate the optics again"
            )
        if not (np.isfinite(dark).all() and np.isfinite(gain).all() and (gain >= 0).all()):
            raise _no_field(
                "the flat field has values that are negative or not finite: calibrate the optics "
                "again"
            )
        if not gain.any():
            raise _no_field("every pixel is dead in the flat field: calibrate the optics again")
        self.dark = np.ascontiguousarray(dark, np.float32)
        self.gain = np.ascontiguousarray(gain, np.float32)

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
            raise _no_field(
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
                f"{white.shape[1]} × {white.shape[0]}: use one source for both",
                about="frames",
            )
        span = white - dark
        usual = float(np.median(span))
        if usual < LEAST_SPAN:
            raise CalibrationError(
                f"white is only {usual:.0f} grey levels brighter than dark, {LEAST_SPAN:.0f} are "
                "needed: is the light on, the sensor covered for the dark and on white paper "
                "after?",
                about="white",
            )
        saturated = float((white >= SATURATED).mean())
        if saturated > MOST_SATURATED:
            raise CalibrationError(
                f"{saturated:.0%} of the pixels are saturated on white paper: lower the exposure "
                "or the light",
                about="white",
            )
        broken = (span < DEAD_SHARE * usual) | (dark > np.median(dark) + HOT_LEVELS)
        if broken.mean() > MOST_BROKEN:
            raise CalibrationError(
                f"{int(broken.sum())} of {broken.size} pixels are dead or hot: is the field of "
                "view free, lit evenly enough and really dark when covered?",
                about="pixels",
            )
        level = float(np.median(white[~broken]))
        gain = np.where(broken, 0.0, level / np.where(broken, 1.0, span))
        return cls(dark.astype(np.float32), gain.astype(np.float32))

    def to_bytes(self) -> bytes:
        """Return the flat field as the bytes of its file."""
        file = BytesIO()
        np.savez_compressed(file, dark=self.dark, gain=self.gain)
        return file.getvalue()

    def save(self, path: str | Path) -> None:
        """Write the flat field to an ``.npz`` file."""
        write_bytes(Path(path), self.to_bytes(), SourceError)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the flat field of a file."""
        if not Path(path).exists():
            message = (
                f"no flat field {path}: put it beside the profile, or remove optics.flat_field"
            )
            raise _no_field(message)
        with open_file(Path(path), SourceError, MOST_BANK_BYTES) as file:
            try:
                stored = read_arrays(file)
                dark, gain = (np.asarray(stored[name], np.float32) for name in ("dark", "gain"))
            except (OSError, ValueError, TypeError, KeyError):
                raise _no_field(
                    f"{path} is not a flat field: calibrate the optics again, or remove "
                    "optics.flat_field"
                ) from None
        return cls(dark, gain)


def _no_field(message: str) -> SourceError:
    key = "optics.flat_field"
    return SourceError(message, about=key, remedy=key)


def mean_image(images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Return the mean of images of one shape."""
    if not len(images):
        raise CalibrationError("no frames arrived: check the source", about="frames")
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        raise CalibrationError(
            f"the frames differ in shape, {sorted(shapes)}: use one source", about="frames"
        )
    total = np.zeros(images[0].shape)
    for image in images:
        total += image
    return total / len(images)
