"""Sources from what a program has at hand: a URL, a path, images, or an iterable of them."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SourceError
from smarttouch.profile import Profile
from smarttouch.sources import open_source
from smarttouch.sources.frame import Frame
from smarttouch.sources.input_checks import gray_image
from smarttouch.sources.source import OpticalSource, Source

Given = Source | str | Path | NDArray[np.uint8] | Iterable[Any]
"""What a source can be made of."""
_BY_SUFFIX = {".mcap": "recording", ".avi": "video", ".mkv": "video", ".mov": "video",
              ".mp4": "video", ".webm": "video"}  # fmt: skip


class Images(OpticalSource):
    """Images one after another, one for each sequence; at the finger's full force."""

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
        number, self.frames = self.frames, self.frames + 1
        if isinstance(image, Frame):
            return replace(image, time_ns=time_ns, number=number)
        gray = gray_image(image, self.title)
        return Frame(gray, time_ns, force_n=self._press_n, number=number)


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
    if isinstance(given, str):
        path = Path(given)
        if ":" in given or not path.exists():
            return open_source(given, profile, light_on_dark=light_on_dark)
        given = path
    if isinstance(given, Path):
        kind = "frames" if given.is_dir() else _BY_SUFFIX.get(given.suffix.lower(), "page")
        return open_source(f"{kind}:{given}", profile, light_on_dark=light_on_dark)
    if isinstance(given, np.ndarray) and given.ndim < 3:
        raise SourceError(
            f"an array of {given.dtype} {given.shape} is no row of images: give (N, H, W) uint8",
            about="source",
        )
    if not isinstance(given, Iterable) or isinstance(given, bytes | dict):
        raise SourceError(
            f"a {type(given).__name__} is no source: give a Source, a URL such as 'text:Hello', a "
            "path, or images",
            about="source",
        )
    return Images(given, profile)
