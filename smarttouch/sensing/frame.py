"""What every sensor delivers, and the contract of a sensor."""

from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray


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
        When it was taken, on the sensor's own clock.
    pose : Pose
        Where it was taken.
    force_n : float, N
        How hard the finger presses.
    """

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose
    force_n: float


@runtime_checkable
class Sensor(Protocol):
    """A source of frames, opened by its URL."""

    title: str
    """What it is, in a few words, for the screen."""
    duration_s: float | None
    """How long it lasts; None if it never ends by itself."""
    dropped_frames: int
    """Frames that came but were never read."""

    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start; None at the end."""

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...
