"""Sources with a live device: a thread captures its images, and a run reads the newest one."""

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
from smarttouch.sources.flat_field_and_motion import FramePreprocessor
from smarttouch.sources.source_contract import (
    DeviceWarnings,
    Frame,
    OpticalSource,
)

STALE_NS = 500_000_000  # age above which an image is stale


@dataclass(frozen=True, eq=False)
class Shot:
    """One captured image.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Gray levels; the device must not change the array afterwards.
    taken_ns : int
        `time.perf_counter_ns` when the image was taken or received.
    missed : int
        Number of images lost or skipped since the previous shot.
    """

    image: NDArray[np.uint8]
    taken_ns: int
    missed: int = 0


class ImageDevice(ABC):
    """Device that delivers images to a `LiveSource`, which calls it from one thread at a time."""

    title: str
    """Short name of the device."""

    @cached_property
    def notes(self) -> list[str]:
        """Warnings for the user; they become notes of the `LiveSource`."""
        return []

    @abstractmethod
    def open(self) -> None:
        """Open the device, or reopen it after a loss. Raises SourceError."""

    @abstractmethod
    def grab(self, timeout_s: float) -> Shot | None:
        """Return the next image, or None after ``timeout_s``.

        Raises
        ------
        SourceLostError
            If the device is lost.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the device in any state. Never raise."""


FIRST_IMAGE_S = 2.0  # longest wait for the first image, as devices start slowly
GRAB_S = 0.1  # longest wait in `ImageDevice.grab`; it is short, because closing waits for `grab`
RETRY_S = 0.25  # interval of attempts to reopen a lost device
JOIN_S = 2.0  # longest wait for the end of the thread, which hangs if the device's driver hangs


class LiveSource(OpticalSource):
    """Source of images of a live device. A thread grabs images, and `read` returns the newest.

    The first `read` starts the thread; earlier images are lost. The pose starts at (0, 0). It is
    the sum of the motions between all images, including images that are never read.

    Parameters
    ----------
    device : ImageDevice
        Device that is not open. The source opens it immediately and closes it at the end.
    profile : Profile
        Profile with the optics: scale of the motion, and flat field.
    replug_s : float, s
        Longest wait for the return of a lost device.
    now_ns : callable
        Clock of `Shot.taken_ns`.

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
        """Return the newest frame without waiting; None after closing.

        The first read waits for the first image. ``force_n`` is NaN.

        Raises
        ------
        SourceError
            If the first image does not arrive in time, or the device is lost or fails.
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
            self.notes.append(f"{self.title} did not respond within {JOIN_S:g} s and was left open")

    def _grab_all(self) -> None:
        """Grab images until the source is closed. Store exceptions, which `read` then raises."""
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
        """Return the next image, or None; try to reopen a lost device."""
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
        """Update the warning about a lost device. If ``shot`` is an image, the device has returned.
        Raises SourceError if the device does not return within ``replug_s``."""
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
