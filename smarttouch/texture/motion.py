"""Interface of hand motion, and opening a source of it by URL."""

import math
from abc import ABC, abstractmethod
from importlib import import_module
from typing import Any

from smarttouch.errors import SourceError
from smarttouch.registry import given_options, known_names, unknown
from smarttouch.sources.device import Device
from smarttouch.url_options import joined_options, read_options

_OPENERS = {
    "evdev": ("smarttouch.texture.evdev_motion", "open_evdev"),
    "path": ("smarttouch.texture.path_motion", "open_path"),
    "sweep": ("smarttouch.texture.sweep_motion", "open_sweep"),
    "window": ("smarttouch.texture.window_motion", "open_window"),
}
"""Module and function ``(rest, **options)`` of each kind; imported when one is opened."""
_NOT_IN_URLS = ("span_mm", "lane_mm", "origin_mm")
"""Options of a sweep that follow from the texture."""
_ANY_SOURCE = ("smarttouch.texture.source_motion", "open_posed_source")


class Motion(Device, ABC):
    """Source of the displacement of a hand, opened by its URL.

    It starts at `origin_mm` of a texture, from its top left corner, known after the first read; in
    the middle if that is None. `force_n` is that of the finger at the last read, where
    `knows_force`.
    """

    duration_s: float | None = None
    """Duration of the motion; None if it never ends by itself."""
    resolution_mm: float = 0.0
    """Resolution of the motion: at rest it may jump to and fro by so much."""

    def __init__(self, title: str) -> None:
        super().__init__(title)
        self.knows_force = self.measures_force = False
        self.force_n = math.nan
        self.origin_mm: tuple[float, float] | None = None

    @abstractmethod
    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the displacement from the start, right and down, mm; None at the end."""


def open_motion(url: str, **options: Any) -> Motion:
    """Open ``sweep:``, ``evdev:DEVICE``, ``window:``, ``path:CSV``, or any source with a pose.

    Options may stand in the URL, as in ``sweep:?speed_mm_s=20``; None is an option not given.
    """
    kind, colon, rest = url.partition(":")
    sources = known_names("smarttouch.sources")
    if not colon or kind not in {*_OPENERS, *sources}:
        raise unknown("motion", url, (*_OPENERS, *sources), SourceError)
    module, function = _OPENERS.get(kind, _ANY_SOURCE)
    opener = getattr(import_module(module), function)
    given = given_options(opener, url, options, SourceError)
    if kind not in _OPENERS:
        motion: Motion = opener(url, **given)
    else:
        rest, in_url = read_options(opener, rest, SourceError, _NOT_IN_URLS)
        motion = opener(rest, **joined_options(url, given, in_url, SourceError))
    return motion
