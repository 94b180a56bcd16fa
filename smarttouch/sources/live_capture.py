"""Capture from a live device on a thread of its own; the newest image wins."""

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.profile import Profile
from smarttouch.sources.preprocess import FramePreprocessor
from smarttouch.sources.source_contract import (
    DeviceWarnings,
    Frame,
    OpticalSource,
)

STALE_NS = 500_000_000  # time without a new image after which the last one is stale


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
        """

    @abstractmethod
    def close(self) -> None:
        """Close the device. Never raises, in any state."""


FIRST_IMAGE_S = 2.0  # time limit of the first read, as devices start slowly
GRAB_S = 0.1  # longest wait for a device in one call, so that closing is prompt
RETRY_S = 0.25  # interval of attempts to reopen a lost device
JOIN_S = 2.0  # time to wait for a driver that hangs, before it is abandoned


class LiveSource(OpticalSource):
    """Newest frame wins: a thread grabs images, `read` takes the newest.

    The thread begins with the first `read`; images from before a run are discarded.
    Motion is followed from every image to the next, also those that are never read,
    and summed into the pose, which begins at (0, 0).

    Parameters
    ----------
    device : ImageDevice
        Not open yet. The source opens it, at once, and closes it.
    profile : Profile
        Optics: scale of the motion, flat field.
    replug_s : float, s
        Longest wait for a lost device.
    now_ns : callable
        The clock of `Shot.taken_ns`.

    Raises
    ------
    SourceError
        If the device cannot be opened.
    """

    frames: int
    dropped_frames: int

    def __init__(
        self,
        device: ImageDevice,
        profile: Profile,
        *,
        replug_s: float = 10.0,
        now_ns: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        super().__init__(device.title)
        self.notes: list[str] = device.notes
        self._device = device
        self._replug_s = replug_s
        self._now_ns = now_ns
        self._intake = FramePreprocessor(profile)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._changed = threading.Condition()  # guards the counts and all attributes below
        self._newest: Frame | None = None
        self._taken_ns = 0
        self._unread = False
        self._closed = False
        self._failure: SourceError | None = None
        self._raised = False
        self._is_open = True
        self._lost_ns: int | None = None
        self._warnings = DeviceWarnings(self.notes)
        try:
            device.open()
        except BaseException:
            device.close()
            raise

    def read(self, time_ns: int) -> Frame | None:
        """Return the newest frame, without waiting; None once it is closed.

        The first read waits for the first image. ``force_n`` is not known.

        Raises
        ------
        SourceError
            If no first image came in time, the device is lost, or it failed.
        """
        with self._changed:
            if self._closed:
                return None
            if self._thread is None:
                self._thread = threading.Thread(target=self._grab_all, daemon=True)
                self._thread.start()
                self._changed.wait_for(lambda: self._newest or self._failure, FIRST_IMAGE_S)
            if self._failure is not None:
                self._raised = True
                raise self._failure
            newest = self._newest
            if newest is None:
                message = (
                    f"{self.title} gave no image within {FIRST_IMAGE_S:g} s: check that it is on, "
                    "and that no other program uses it"
                )
                raise SourceError(message)
            self._unread = False
            age_ns = max(0, self._now_ns() - self._taken_ns)
        return replace(newest, time_ns=time_ns, age_ns=age_ns, stale=age_ns > STALE_NS)

    def close(self) -> None:
        """Stop the thread, close the device, and count unread frames as dropped."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self.dropped_frames += self._unread
            self._unread = False
            if self._failure is not None and not self._raised:
                self.notes.append(str(self._failure))
        self._stop.set()
        if self._thread is None:
            self._device.close()
            return
        self._thread.join(JOIN_S)
        if self._thread.is_alive():
            self.notes.append(f"{self.title} did not answer within {JOIN_S:g} s and was left open")

    def _grab_all(self) -> None:
        """Grab image after image; any exception is raised by `read`."""
        try:
            while not self._stop.is_set():
                shot = self._grab()
                if shot is not None:
                    self._take(shot)
        except SourceError as error:
            self._fail(error)
        except Exception as error:
            failure = SourceError(f"{self.title} failed: {type(error).__name__}: {error}")
            failure.__cause__ = error
            self._fail(failure)
        finally:
            with self._changed:
                self._changed.notify_all()
            self._device.close()

    def _grab(self) -> Shot | None:
        """Return the next image; try to reopen a lost device."""
        try:
            if not self._is_open:
                if self._stop.wait(RETRY_S):
                    return None
                self._device.open()
                self._is_open = True
            shot = self._device.grab(GRAB_S)
        except SourceError as error:
            if self._is_open and not isinstance(error, SourceLostError):
                raise
            self._device.close()
            self._is_open = False
            shot = None
            if self._lost_ns is None:
                self._lost_ns = self._now_ns()
        if self._lost_ns is not None:
            self._await_return(self._lost_ns, shot)
        return shot

    def _await_return(self, lost_ns: int, shot: Shot | None) -> None:
        """Count a device as back when an image comes, not when it can be opened."""
        gone_s = (self._now_ns() - lost_ns) / 1e9
        self._warnings.put(f"lost {lost_ns}", f"{self.title} was disconnected for {gone_s:.1f} s")
        if shot is not None:
            self._lost_ns = None
            self._intake.interrupt()
        elif gone_s > self._replug_s:
            message = (
                f"{self.title} was disconnected and did not return within {self._replug_s:g} s: "
                "plug it in and start again"
            )
            raise SourceError(message)

    def _take(self, shot: Shot) -> None:
        image, pose = self._intake.take(shot.image)
        with self._changed:
            if self._closed:
                return
            self.frames += shot.missed + 1
            self.dropped_frames += shot.missed + self._unread
            self._newest = Frame(image, 0, pose, math.nan, number=self.frames - 1)
            self._taken_ns = shot.taken_ns
            self._unread = True
            self._changed.notify_all()

    def _fail(self, failure: SourceError) -> None:
        with self._changed:
            if self._closed:
                self.notes.append(str(failure))
            self._failure = failure
