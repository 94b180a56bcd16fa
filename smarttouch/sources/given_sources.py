"""Sources from what a program has at hand, and checks of what a source returns."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError, kind_in_words
from smarttouch.base.events import Emit
from smarttouch.pages.grey_image import to_grey
from smarttouch.profile import Profile
from smarttouch.profile.electrodes import ElectrodeArray
from smarttouch.sources import kind_of, open_source
from smarttouch.sources.source_contract import (
    Frame,
    Input,
    OpticalSource,
    Source,
    Stimulus,
    StimulusSource,
)


def checked_input(given: Any, who: object, electrodes: int) -> Input:
    """Return a frame or stimulus that a source ``who`` returned, for (E,) electrodes.

    Raises a SourceError for anything else, with what it is.
    """
    if isinstance(given, Frame):
        image = given.image
        if type(image) is np.ndarray and image.dtype == np.uint8 and image.ndim == 2 and image.size:
            return given
        return replace(given, image=gray_image(image, who))
    if not isinstance(given, Stimulus):
        raise SourceError(
            f"{who} returned {kind_in_words(given)}: a source returns a Frame or a Stimulus, or "
            "None at its end"
        )
    return replace(given, activation=checked_activation(given.activation, who, electrodes))


def gray_image(image: Any, who: object) -> NDArray[np.uint8]:
    """Return an image as gray levels, (H, W) uint8, 0 black: from bool, gray, RGB or RGBA.

    The ground under transparent print is chosen so that it is seen. Raises a SourceError for other
    types and shapes: which number is white would be a guess.
    """
    if not (
        isinstance(image, np.ndarray)
        and image.dtype in (np.uint8, np.bool_)
        and image.size
        and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3, 4)))
    ):
        raise SourceError(
            f"{who} gave an image that is {kind_in_words(image)}: give gray levels (H, W) uint8, "
            "0 black and 255 white, or RGB (H, W, 3)"
        )
    return to_grey(image)


def checked_activation(activation: Any, who: object, electrodes: int) -> NDArray[np.float32]:
    """Return the activation of (3, E) electrodes as float32, of numbers in [0, 1] alone."""
    shape = len(Afferent), electrodes
    if (
        not isinstance(activation, np.ndarray)
        or activation.dtype.kind not in "fbiu"
        or activation.shape != shape
    ):
        raise SourceError(
            f"{who} gave an activation that is {kind_in_words(activation)}: give an array "
            f"of {shape}, in [0, 1], a row for each of RA, SAI and PC"
        )
    # Reject NaN: every comparison with it is false.
    lowest, highest = float(activation.min()), float(activation.max())
    if not 0 <= lowest <= highest <= 1:
        raise SourceError(
            f"{who} gave an activation from {lowest:g} to {highest:g}: it must be in [0, 1]"
        )
    return activation if activation.dtype == np.float32 else activation.astype(np.float32)


Given = Source | str | Path | NDArray[np.uint8] | Iterable[Any]  # what a source can be made of


class Images(OpticalSource):
    """Images one after another, one for each sequence; at the finger's full force."""

    frames: int
    knows_force = True
    ended = "all images have been shown"

    def __init__(self, images: Iterable[Any], profile: Profile) -> None:
        super().__init__("images")
        self._images: Iterator[Any] = iter(images)
        self._press_n = profile.force.full_n

    def read(self, time_ns: int) -> Frame | None:
        """Return the next image; None after the last."""
        image = next(self._images, None)
        if image is None:
            return None
        self.frames += 1
        if isinstance(image, Frame):
            return replace(image, time_ns=time_ns, number=self.frames - 1)
        gray = gray_image(image, self.title)
        return Frame(gray, time_ns, force_n=self._press_n, number=self.frames - 1)


def source_of(given: Given, profile: Profile, *, light_on_dark: bool = False) -> Source:
    """Return the source that a program asks for.

    Parameters
    ----------
    given : Source, str, Path, ndarray or iterable
        A source; its URL; the path of an image, document, video, folder of images or recording;
        images (N, H, W) uint8 or, in color, (N, H, W, 3); or an iterable of images or frames.
    profile : Profile
        Its optics and the finger's force.
    light_on_dark : bool
        Whether print is lighter than paper.

    Raises
    ------
    SourceError
        If it is nothing of these, or cannot be opened.
    """
    if isinstance(given, Source):
        return given
    if isinstance(given, str | Path):
        url = given if isinstance(given, str) else f"{kind_of(given)}:{given}"
        return open_source(url, profile, light_on_dark=light_on_dark)
    if isinstance(given, np.ndarray) and given.ndim < 3:
        raise SourceError(
            f"an array of {given.dtype} {given.shape} is no row of images: give (N, H, W) uint8"
        )
    if not isinstance(given, Iterable) or isinstance(given, bytes | dict):
        raise SourceError(
            f"a {type(given).__name__} is no source: give a Source, a URL such as 'text:Hello', a "
            "path, or images"
        )
    return Images(given, profile)


Imaging = Callable[[Frame, ElectrodeArray], NDArray[np.floating[Any]]]
"""Returns the activation of each class at each electrode, (3, E) in [0, 1], of a frame."""


_OF_THE_SOURCE = (
    "url", "duration_s", "knows_force", "measures_force", "narrowed",
)  # fmt: skip


class OwnImaging(StimulusSource):
    """Stimuli that a function makes of an optical source's frames; recordings keep both."""

    def __init__(self, source: Source, imaging: Imaging, profile: Profile) -> None:
        super().__init__(source.title)
        for name in _OF_THE_SOURCE:
            setattr(self, name, getattr(source, name))
        self._source, self._imaging, self._electrodes = source, imaging, profile.electrodes
        self._who = getattr(imaging, "__qualname__", type(imaging).__name__)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return what the function makes of the next frame; None at the end."""
        given = self._source.read(time_ns)
        self._count()
        if given is None:
            return None
        electrodes = len(self._electrodes)
        frame = checked_input(given, self._source, electrodes)
        if not isinstance(frame, Frame):
            raise SourceError(
                f"{self.title} gives tactile images, which need no imaging: leave it out"
            )
        activation = self._imaging(frame, self._electrodes)
        return Stimulus(
            checked_activation(activation, self._who, electrodes), frame.time_ns, frame.force_n,
            pose=frame.pose, number=frame.number, age_ns=frame.age_ns, stale=frame.stale,
            image=frame.image, period_us=frame.period_us,
        )  # fmt: skip

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the source."""
        return self._source.keys

    @property
    def emit(self) -> Emit:
        """Receives the source's events."""
        return self._source.emit

    @emit.setter
    def emit(self, emit: Emit) -> None:
        self._source.emit = emit

    def close(self) -> None:
        """Close the source."""
        self._source.close()
        self._count()
        self.notes: list[str] = self._source.notes

    def _count(self) -> None:
        self.frames: int = self._source.frames
        self.dropped_frames: int = self._source.dropped_frames
