"""What every sensor delivers, and the contract of a sensor."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.events import Emit, emit_nowhere
from smarttouch.sources.device import Device


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
class PulseRequest:
    """Pulses that a source asks for by itself: one of each class at each active site, now.

    Attributes
    ----------
    activation : ndarray, (3, E) float32, in [0, 1]
        One row for each `Primary`; no pulse where it is zero.
    period_us : int, µs
        Until the source wants to be asked again.
    level : float, in [0, 1]
        Of the strongest comfortable current, on top of what the user wishes.
    """

    activation: NDArray[np.float32]
    period_us: int
    level: float = 1.0


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
    request : PulseRequest, optional
        What is to be felt, where the source does not leave it to the image.
    """

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose
    force_n: float
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    request: PulseRequest | None = None


class Sensor(Device, ABC):
    """A source of frames, opened by its URL.

    Every frame of the source is either read or dropped: at the end ``frames``
    is the number of distinct frames read plus ``dropped_frames``.
    """

    duration_s: float | None = None
    """How long it lasts; None if it never ends by itself."""
    ended: ClassVar[str] = "the sensor has ended"
    """What its end is called."""
    asks: ClassVar[bool] = False
    """Whether its frames ask for their pulses: then it also chooses the classes."""
    emit: Emit = staticmethod(emit_nowhere)
    """Hands on events of the source; set by the run."""
    knows_force: bool = False
    """Whether its frames tell how hard the finger presses."""
    frames: int = 0
    """Frames that its source delivered."""
    dropped_frames: int = 0
    """Frames that came but were never read."""

    @abstractmethod
    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start; None at the end."""
