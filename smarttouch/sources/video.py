"""Videos and folders of images, at their own pace or as fast as they are read."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SourceError, require_within
from smarttouch.profile import Profile
from smarttouch.sources.capture import LiveSource
from smarttouch.sources.clip import FASTEST_HZ, USUAL_HZ, Clip, ImageFolder, VideoFile
from smarttouch.sources.frame import Frame
from smarttouch.sources.image_device import STALE_S, ImageDevice, Shot, SourceEndedError
from smarttouch.sources.intake import FramePreprocessor
from smarttouch.sources.source import OpticalSource

HOPELESS_NS = 250_000_000
"""Delay after which frames are skipped undecoded until the next one is due."""


def open_video(rest: str, profile: Profile, *, unpaced: bool = False) -> OpticalSource:
    """Open ``video:FILE``, any video that OpenCV reads; ``unpaced`` gives one frame a read."""
    return _open(VideoFile(Path(rest)), profile, unpaced)


def open_frames(
    rest: str, profile: Profile, *, fps: float | None = None, unpaced: bool = False
) -> OpticalSource:
    """Open ``frames:DIR``, a folder of images of one size, in natural order of their names.

    ``fps`` is 30 if not given; ``unpaced`` gives one image a read.
    """
    rate_hz = USUAL_HZ if fps is None else fps
    words = f"a rate of {rate_hz:g} images a second"
    require_within(SourceError, "fps", rate_hz, 0, FASTEST_HZ, words, above=True)
    return _open(ImageFolder(Path(rest), rate_hz), profile, unpaced)


def _open(clip: Clip, profile: Profile, unpaced: bool) -> OpticalSource:
    if unpaced:
        return UnpacedClip(clip, profile)
    source = LiveSource(PacedClip(clip), profile)
    if clip.count:
        source.duration_s = clip.count / clip.rate_hz
    return source


class PacedClip(ImageDevice):
    """Gives each image at its time, as a camera would; the first at the first `grab`."""

    def __init__(
        self,
        clip: Clip,
        now_ns: Callable[[], int] = time.perf_counter_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clip = clip
        self._now_ns, self._sleep = now_ns, sleep
        self.title = clip.title
        self.notes = clip.notes
        self._start_ns: int | None = None
        self._number = 0
        self._ahead: NDArray[np.uint8] | None = None
        self._ended = False
        self._missed = 0

    def open(self) -> None:
        self._clip.open()
        # Slow slides are not stale before the next one is overdue.
        self.stale_s = max(STALE_S, 2 / self._clip.rate_hz)

    def grab(self, timeout_s: float) -> Shot | None:
        if self._start_ns is None:
            self._start_ns = self._now_ns()
        self._catch_up()
        if self._ahead is None and not self._ended:
            self._ahead = self._clip.next()
            self._ended = self._ahead is None
        left_s = (self._due_ns() - self._now_ns()) / 1e9
        if left_s > 0:
            self._sleep(min(left_s, timeout_s))
            if left_s > timeout_s:
                return None
        missed, self._missed = self._missed, 0
        if self._ahead is None:
            raise SourceEndedError(missed=missed)
        shot = Shot(self._ahead, self._due_ns(), missed)
        self._ahead = None
        self._number += 1
        return shot

    def _due_ns(self) -> int:
        return (self._start_ns or 0) + round(self._number * 1e9 / self._clip.rate_hz)

    def _catch_up(self) -> None:
        """Skip images that are too late."""
        if self._now_ns() - self._due_ns() <= HOPELESS_NS:
            return
        while self._now_ns() > self._due_ns() and not self._ended:
            if self._ahead is not None:
                self._ahead = None
            elif not self._clip.skip():
                self._ended = True
                break
            self._missed += 1
            self._number += 1

    def close(self) -> None:
        self._clip.close()


class UnpacedClip(OpticalSource):
    """Gives the next image at each read; none is dropped, however long the reader takes."""

    def __init__(self, clip: Clip, profile: Profile) -> None:
        super().__init__(clip.title)
        self._intake = FramePreprocessor(profile)
        self._clip = clip
        self.notes = clip.notes
        clip.open()

    def read(self, time_ns: int) -> Frame | None:
        """Return the next frame; None at the end."""
        image = self._clip.next()
        if image is None:
            return None
        image, pose = self._intake.take(image)
        self.frames += 1
        return Frame(image, time_ns, pose, math.nan, number=self.frames - 1)

    def close(self) -> None:
        """Close the file."""
        self._clip.close()
