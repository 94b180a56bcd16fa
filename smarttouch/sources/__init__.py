"""Frames, stimuli and finger force: from pages, cameras, videos, serial sensors and load cells."""

import inspect
from typing import Any

from smarttouch.base.errors import SourceError
from smarttouch.base.registry import find_opener, given_options
from smarttouch.base.url_options import joined_options, read_options
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Source


def open_source(
    url: str, profile: Profile, *, light_on_dark: bool = False, **options: Any
) -> Source:
    """Open a source by its URL, for example ``page:FILE`` or ``camera:0``.

    Parameters
    ----------
    url : str
        Kind and place of the source; options of its kind may follow, as in
        ``page:scan.png?dpi=300``, except ``light_on_dark``, which imaging needs as well.
    profile : Profile
        Its optics and the finger's force.
    light_on_dark : bool
        Whether print is lighter than paper, for sources that detect print themselves.
    **options
        Options of this kind of source, see its module; None means not given.

    Raises
    ------
    SourceError
        If the kind or an option of it is unknown, or it cannot be opened.

    Examples
    --------
    >>> import smarttouch as st
    >>> with st.open_source("text:touch", st.load_profile("electric-mouse")) as source:
    ...     source.read(0).image.shape
    (64, 64)
    """
    opener, rest = find_opener("smarttouch.sources", url, SourceError, Source, ("rest", "profile"))
    rest, in_url = read_options(opener, rest, SourceError, but=("light_on_dark",))
    given = given_options(opener, url, options, SourceError)
    given = joined_options(url, given, in_url, SourceError)
    if light_on_dark and "light_on_dark" in inspect.signature(opener).parameters:
        given["light_on_dark"] = True
    source: Source = opener(rest, profile, **given)
    source.url = url
    return source
