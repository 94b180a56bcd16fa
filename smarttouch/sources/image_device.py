"""Devices that live sources take their images from."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

STALE_S = 0.5
"""Time without a new image after which the last one is stale."""


class SourceEndedError(Exception):
    """A device has no more images, as at the end of a file.

    ``note`` is a warning for the user, ``missed`` the number of images skipped since the last
    shot.
    """

    def __init__(self, note: str = "", missed: int = 0) -> None:
        super().__init__(note)
        self.missed = missed


@dataclass(frozen=True, eq=False)
class Shot:
    """One captured image.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Grey; the device does not write to it again.
    taken_ns : int
        `time.perf_counter_ns` when it was taken or came in.
    missed : int
        Images of the device that were lost or skipped since the shot before.
    """

    image: NDArray[np.uint8]
    taken_ns: int
    missed: int = 0


class ImageDevice(ABC):
    """Device that a live source takes its images from; used by one thread at a time."""

    title: str
    """Name of the device, in a few words."""
    stale_s: float = STALE_S
    """Age after which an image is stale; longer only for slow images."""

    @cached_property
    def notes(self) -> list[str]:
        """Warnings for the user; `LiveSource` passes them on as its own."""
        return []

    @abstractmethod
    def open(self) -> None:
        """Open the device, or reopen it after a loss; raise SourceError if that fails."""

    @abstractmethod
    def grab(self, timeout_s: float) -> Shot | None:
        """Return the next image; None if none came within ``timeout_s``.

        Raises
        ------
        SourceLostError
            If the device is lost.
        SourceEndedError
            If there will be no more images.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the device. Never raises, in any state."""
