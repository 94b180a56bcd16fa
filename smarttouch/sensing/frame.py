"""What every sensor delivers, and the contract of a sensor."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.sensing.device import Device


@dataclass(frozen=True)
class Pose:
    """Where the center of the sensor patch is on the page.

    ``x_mm`` runs right and ``y_mm`` down from the page's top left corner;
    ``angle_rad`` turns the patch clockwise as seen on the page.
    """

    x_mm: float
    y_mm: float
    angle_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One look of the sensor.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Grey levels, bright is white.
    time_ns : int
        When it is felt: the time that was asked for, since the start of the run.
    pose : Pose
        Where it was taken.
    force_n : float, N
        How hard the finger presses; NaN where the sensor does not know.
    number : int
        Of the image at its source, from 0; the same number is the same image again.
    age_ns : int
        How old the image was when it was asked for.
    stale : bool
        The sensor has fallen silent: what the image shows may be gone.
    """

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose
    force_n: float
    number: int = 0
    age_ns: int = 0
    stale: bool = False


class Sensor(Device, ABC):
    """A source of frames, opened by its URL.

    Every frame of the source is either read or dropped: at the end ``frames``
    is the number of distinct frames read plus ``dropped_frames``.
    """

    duration_s: float | None = None
    """How long it lasts; None if it never ends by itself."""
    ended: ClassVar[str] = "the sensor has ended"
    """What its end is called."""
    keys_help: ClassVar[str] = ""
    """What its keys are for, a few words."""
    knows_force: bool = False
    """Whether its frames tell how hard the finger presses."""
    frames: int = 0
    """Frames that its source delivered."""
    dropped_frames: int = 0
    """Frames that came but were never read."""

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """What single keys do to it while it is felt; called from any thread."""
        return {}

    @abstractmethod
    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start; None at the end."""
