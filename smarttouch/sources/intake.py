"""Preprocessing of every incoming image: flat field and pose."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.sources.flat_field import FlatField
from smarttouch.sources.frame import Pose
from smarttouch.sources.motion import MotionTracker


class FramePreprocessor:
    """Corrects images by the profile's flat field, and sums the motion between them to a pose."""

    def __init__(self, profile: Profile) -> None:
        self._correct: Callable[[NDArray[np.uint8]], NDArray[np.uint8]] | None = None
        if profile.optics.flat_field is not None:
            flat_field = FlatField.load(Path(profile.optics.flat_field))
            # The first call may import scipy, which must not delay the first image of a run.
            flat_field.correct(np.zeros(flat_field.gain.shape, np.uint8))
            self._correct = flat_field.correct
        self._tracker = MotionTracker(profile)
        self._x_mm = self._y_mm = self._angle_rad = 0.0

    def take(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Pose]:
        """Return the corrected image, and its pose."""
        if self._correct is not None:
            image = self._correct(image)
        x_mm, y_mm = self._tracker.follow(image)
        self._angle_rad += self._tracker.turn_rad
        cos, sin = math.cos(self._angle_rad), math.sin(self._angle_rad)
        self._x_mm += cos * x_mm - sin * y_mm
        self._y_mm += sin * x_mm + cos * y_mm
        return image, Pose(self._x_mm, self._y_mm, self._angle_rad)

    def interrupt(self) -> None:
        """Ignore the motion to the next image, after an unknown time."""
        self._tracker.forget()
