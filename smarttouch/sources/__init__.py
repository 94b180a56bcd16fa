"""Sources of frames, stimuli and force: pages, cameras, videos, serial sensors, load cells."""

import inspect
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from smarttouch.base.errors import SourceError
from smarttouch.base.files import file_at, named_file
from smarttouch.base.urls import Registry, all_options, read_options, unknown
from smarttouch.profile import Profile, load_profile
from smarttouch.sources.source_contract import Given, Images, Source

SOURCES = Registry(
    "smarttouch.sources",
    Source,
    SourceError,
    {
        "brltty": "smarttouch.reading.brltty_display:BrailleDisplaySource",
        "camera": "smarttouch.sources.camera:open_camera",
        "frames": "smarttouch.sources.image_sequences:open_frames",
        "page": "smarttouch.sources.virtual_finger:open_page",
        "recording": "smarttouch.running.recorded_source:open_recording",
        "serial-array": "smarttouch.sources.serial_sensors:open_serial_array",
        "socket": "smarttouch.instruments.pattern_socket:SocketSource",
        "text": "smarttouch.sources.virtual_finger:open_text",
        "texture": "smarttouch.instruments.electric_mouse:open_texture_source",
        "vibration": "smarttouch.instruments.vibration_stimuli:open_vibration",
        "video": "smarttouch.sources.image_sequences:open_video",
    },
)
_NOT_IN_URLS = ("light_on_dark", "mode", "rate_hz", "display", "vibrated")  # options set by the run
_SUFFIXES = {"recording": (".mcap",), "video": (".avi", ".mkv", ".mov", ".mp4", ".webm")}


def kind_of(path: Path) -> str:
    """Return the kind of source that opens this file or folder."""
    if path.is_dir():
        return "frames"
    suffix = path.suffix.lower()
    return next((kind for kind, known in _SUFFIXES.items() if suffix in known), "page")


_KIND = re.compile("[A-Za-z0-9_-]+")


def source_url(name: str) -> str:
    """Return the URL of the source that a user has named by a URL, a file, a folder or a text.

    Raises SourceError if the name looks like a misspelt kind of source or a missing file.
    """
    kind, colon, rest = name.partition(":")
    # "Note: this" and "3:30 p.m." are texts, not URLs.
    if colon and _KIND.fullmatch(kind) and not (rest[:1].isspace() or kind.isdecimal()):
        return name
    address = name.rpartition("?")[0] or name
    path = named_file(address, SourceError) if file_at(name) is None else Path(name)
    if path is not None:
        return f"{kind_of(path)}:{name}"
    known = SOURCES.names  # searches installed packages, which takes a while
    from difflib import get_close_matches

    if name in known or (len(name) > 3 and get_close_matches(name.lower(), known, 1, 0.8)):
        raise unknown("source", name, known, SourceError)
    return f"text:{name}"


def options_taken(url: str) -> set[str]:
    """Return the names of the options that a source accepts and its URL does not set."""
    opener, rest = SOURCES.find(source_url(url))
    in_url = read_options(opener, rest, SourceError, but=_NOT_IN_URLS)[1]
    return inspect.signature(opener).parameters.keys() - in_url


def open_source(
    url: str, profile: Profile | str, *, light_on_dark: bool = False, **options: Any
) -> Source:
    """Open a source by its URL, for example ``page:FILE`` or ``camera:0``.

    Parameters
    ----------
    url : str
        Kind, address and options of the source, as in ``page:scan.png?dpi=300``. The kind can be
        left out for a file, a folder or a text: ``scan.png``, ``Hello``. URLs have no option
        ``light_on_dark``; use the parameter.
    profile : Profile or str
        Profile with the optics of the source and the force of the finger; or its name or file.
    light_on_dark : bool
        Whether print is lighter than paper. Only sources that detect print use it.
    **options
        Options of this kind of source, as listed in its module. None means the default.

    Raises
    ------
    SourceError
        If the kind or an option is unknown, or the source cannot be opened.

    Examples
    --------
    >>> import smarttouch as st
    >>> with st.open_source("text:touch", st.load_profile("electric-mouse")) as source:
    ...     source.read(0).image.shape
    (64, 64)
    """
    url, profile = source_url(url), load_profile(profile)
    opener, rest = SOURCES.find(url)
    rest, accepted = all_options(opener, url, rest, options, SourceError, _NOT_IN_URLS)
    if light_on_dark and "light_on_dark" in inspect.signature(opener).parameters:
        accepted["light_on_dark"] = True
    source: Source = opener(rest, profile, **accepted)
    SOURCES.require_kind(source, url)
    source.url = url
    return source


def source_of(given: Given, profile: Profile, *, light_on_dark: bool = False) -> Source:
    """Return a source for anything that a run accepts as its input.

    Parameters
    ----------
    given : Source, str, Path, ndarray or iterable
        A source; a URL; the path of an image, document, video, folder of images or recording;
        images (N, H, W) uint8 or, in color, (N, H, W, 3); or an iterable of images or frames.
    profile : Profile
        Profile with the optics of the source and the force of the finger.
    light_on_dark : bool
        Whether print is lighter than paper.

    Raises
    ------
    SourceError
        If ``given`` is of none of these types, or cannot be opened.
    """
    if isinstance(given, Source):
        return given
    if isinstance(given, str | Path):
        url = given if isinstance(given, str) else f"{kind_of(given)}:{given}"
        return open_source(url, profile, light_on_dark=light_on_dark)
    if isinstance(given, np.ndarray) and given.ndim < 3:
        raise SourceError(
            f"an array of {given.dtype} {given.shape} does not hold images: give (N, H, W) uint8"
        )
    if not isinstance(given, Iterable) or isinstance(given, bytes | dict):
        raise SourceError(
            f"{type(given).__name__} is not a source: give a Source, a URL such as 'text:Hello', a "
            "path, or images"
        )
    return Images(given, profile)
