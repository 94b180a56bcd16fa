"""Collection of a given number of images from a source."""

import time

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import CalibrationError
from smarttouch.profile import Profile
from smarttouch.sources import open_source
from smarttouch.sources.source import Source

Images = list[NDArray[np.uint8]]

SILENCE_S = 5.0
"""Longest time without a new image, after which the source has ended."""
_LOOK_S = 0.002


def images_of(url: str, profile: Profile, count: int, *, corrected: bool) -> Images:
    """Return the next images of a source by its URL; with the profile's flat field, or without."""
    # What lies in files need not be waited for.
    from_file = url.startswith(("frames:", "video:")) and "unpaced" not in url
    seen_by = profile if corrected else uncorrected(profile)
    with open_source(url, seen_by, unpaced=from_file or None) as source:
        return collect_images(source, count)


def collect_images(source: Source, count: int) -> Images:
    """Return the next images of a source, each once; fewer where it ends before."""
    images: Images = []
    seen: set[int] = set()
    start = time.perf_counter_ns()
    last = time.monotonic()
    while len(images) < count:
        frame = source.read(time.perf_counter_ns() - start)
        if frame is None:
            break
        if frame.number not in seen and not frame.stale and frame.image is not None:
            seen.add(frame.number)
            images.append(frame.image.copy())
            last = time.monotonic()
        elif time.monotonic() - last > SILENCE_S:
            raise CalibrationError(
                f"{source.title} gave {len(images)} of {count} frames, and none for "
                f"{SILENCE_S:g} s: check the source",
                about="frames",
            )
        else:
            time.sleep(_LOOK_S)
    if not images:
        raise CalibrationError(f"{source.title} gave no frames: check the source", about="frames")
    return images


def uncorrected(profile: Profile) -> Profile:
    """Return a profile whose sensors give raw images, without its flat field."""
    optics = profile.optics.model_copy(update={"flat_field": None})
    return profile.model_copy(update={"optics": optics})
