"""Frames: images with the pose and force at which they were taken."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.one_line import one_line


@dataclass(frozen=True)
class Pose:
    """Position of the sensor patch's center on the page.

    ``x_mm`` runs right and ``y_mm`` down from the page's top left corner;
    ``angle_rad`` turns the patch clockwise as seen on the page.
    """

    x_mm: float
    y_mm: float
    angle_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of an optical source.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Grey levels, bright is white.
    time_ns : int
        Requested time, since the start of the run.
    pose : Pose
        Pose of the sensor.
    force_n : float, N
        Force of the finger; NaN if unknown.
    number : int
        Of the image at its source, from 0; the same number is the same image again.
    age_ns : int
        Age of the image when it was read.
    stale : bool
        Whether the source has gone silent and the image may be outdated.
    """

    __repr__ = one_line

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose = Pose(0.0, 0.0)
    force_n: float = math.nan
    number: int = 0
    age_ns: int = 0
    stale: bool = False
