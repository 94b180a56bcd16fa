"""White and dark reference of a sensor from collected images."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError
from smarttouch.profile import Profile
from smarttouch.sources import open_source
from smarttouch.sources.preprocess import FlatField, mean_image
from smarttouch.sources.source_contract import Source

Images = list[NDArray[np.uint8]]

SILENCE_S = 5.0  # longest time without a new image, after which the source has ended
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
                f"{SILENCE_S:g} s: check the source"
            )
        else:
            time.sleep(_LOOK_S)
    if not images:
        raise CalibrationError(f"{source.title} gave no frames: check the source")
    return images


def uncorrected(profile: Profile) -> Profile:
    """Return a profile whose sensors give raw images, without its flat field."""
    optics = profile.optics.model_copy(update={"flat_field": None})
    return profile.model_copy(update={"optics": optics})


_Stack = Sequence[NDArray[np.uint8]]

MOST_UNEVEN = 0.05
"""Largest unevenness of white after correction; with more, the paper is not blank, or it moved."""


@dataclass(frozen=True, eq=False)
class OpticsFound:
    """A flat field, and the figures of the sensor with it."""

    field: FlatField
    # uneven_before, uneven_after: standard deviation of blank paper over its mean. After the
    # correction it is judged on frames that the correction was not made from, if there are two of
    # each kind or more.
    uneven_before: float
    uneven_after: float
    # from frame to frame, of the usual pixel, on white, grey levels; NaN of one frame
    noise_levels: float
    dark_level: float  # of the usual pixel, grey levels
    # dead, hot: pixels that do not answer light, and that shine in the dark
    dead: int
    hot: int
    frames: tuple[int, int]  # dark and white frames used

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        columns, rows = self.field.gain.shape[::-1]
        return (
            f"{columns} × {rows} pixels, blank paper uneven by {self.uneven_before:.1%} before and "
            f"{self.uneven_after:.1%} after, noise {self.noise_levels:.1f} grey levels, "
            f"{self.dead} dead and {self.hot} hot pixels, {self.frames[0]} dark and "
            f"{self.frames[1]} white frames"
        )


def measure_optics(dark: _Stack, white: _Stack) -> OpticsFound:
    """Return the flat field of a sensor from images in the dark and of blank paper."""
    field = FlatField.measure(dark, white)
    before = _uneven(mean_image(white) - mean_image(dark), field)
    after = _held_out(dark, white, field)
    if after > MOST_UNEVEN:
        raise CalibrationError(
            f"blank paper is still uneven by {after:.1%} after correction, above "
            f"{MOST_UNEVEN:.0%}: use blank paper, hold it still, and take more with --frames"
        )
    stack = np.stack(list(white)).astype(np.float32)
    noise = float(np.median(stack.std(axis=0, ddof=1))) if len(stack) > 1 else float("nan")
    broken = field.gain == 0
    hot = broken & (field.dark > np.median(field.dark) + 1)
    span = mean_image(white) - mean_image(dark)
    dead = broken & (span < 0.5 * np.median(span))
    return OpticsFound(
        field, before, after, noise, float(np.median(field.dark)), int(dead.sum()),
        int((hot & ~dead).sum()), (len(dark), len(white)),
    )  # fmt: skip


def _held_out(dark: _Stack, white: _Stack, field: FlatField) -> float:
    """Return the unevenness of paper after a correction made from every other frame only."""
    if min(len(dark), len(white)) > 1:
        field = FlatField.measure(dark[::2], white[::2])
        white = white[1::2]
    corrected = mean_image([field.correct(image) for image in white])
    return _uneven(corrected, field)


def _uneven(levels: NDArray[np.float64], field: FlatField) -> float:
    good = levels[field.gain > 0]
    return float(good.std() / good.mean())
