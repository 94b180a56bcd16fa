"""Stimuli: tactile images that a source gives by itself, without an image to be felt."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.sources.frame import Frame, Pose
from smarttouch.tactile_image import TactileImage

_ORIGIN = Pose(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Stimulus(TactileImage):
    """Tactile image with its own level and, if it wishes, its own period: see `TactileImage`.

    Attributes
    ----------
    activation, time_ns, force_n, level
        See `TactileImage`; the force is NaN where the source does not know.
    period_us : int, µs, optional
        Until the source wants to be read again; every class that is active pulses once. None:
        the mode's classes pulse at the profile's rates.
    pose : Pose
        Where the finger is.
    number : int
        At its source, from 0; the same number is the same place or part again.
    age_ns : int
        How old it was when it was asked for.
    stale : bool
        The source has fallen silent: nothing may be felt of it.
    image : ndarray, (H, W) uint8, optional
        Grey levels of what lies under the finger, where there is something to see.
    """

    pose: Pose = _ORIGIN
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    image: NDArray[np.uint8] | None = None


Input = Frame | Stimulus
"""Input of a run, read once for each sequence."""
