"""Stimuli: tactile images that a source gives directly, without imaging."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.one_line import one_line
from smarttouch.sources.frame import Frame, Pose
from smarttouch.tactile_image import TactileImage

_ORIGIN = Pose(0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Stimulus(TactileImage):
    """Tactile image of a source, with an optional period of its own: see `TactileImage`.

    Attributes
    ----------
    activation, time_ns, force_n, level
        See `TactileImage`; the force is NaN if unknown.
    period_us : int, µs, optional
        Time to the next read, in which every active class pulses once. None: the mode's
        classes pulse at the profile's rates.
    pose : Pose
        Pose of the finger.
    number : int
        Number at its source, from 0; equal numbers mean the same place or part.
    age_ns : int
        Age when it was read.
    stale : bool
        Whether the source has gone silent; such a stimulus makes no current.
    image : ndarray, (H, W) uint8, optional
        Grey levels under the finger, for display.
    """

    __repr__ = one_line

    pose: Pose = _ORIGIN
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    image: NDArray[np.uint8] | None = None


Input = Frame | Stimulus
"""Input of a run, read once for each sequence."""
