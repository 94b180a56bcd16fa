"""Sources of what is felt: pages, cameras, files, serial arrays; and of finger force."""

import inspect
from typing import Any

from smarttouch.errors import SourceError
from smarttouch.profile import Profile
from smarttouch.registry import find_opener, given_options
from smarttouch.sources.source import Source
from smarttouch.url_options import joined_options, read_options


def open_source(
    url: str, profile: Profile, *, light_on_dark: bool = False, **options: Any
) -> Source:
    """Open a source by its URL, for example ``page:FILE`` or ``camera:0``.

    Parameters
    ----------
    url : str
        Kind and place of the source; options of its kind may follow, as in
        ``page:scan.png?dpi=300``, all but ``light_on_dark``, which others must know too.
    profile : Profile
        Its optics and the finger's force.
    light_on_dark : bool
        For sources that look for the print by themselves: it is lighter than the paper.
    **options
        What the kind of source takes, see its module; those that are None were not given.

    Raises
    ------
    SourceError
        If there is no such kind, it does not take an option, or cannot be opened.

    Examples
    --------
    >>> import smarttouch as st
    >>> with st.open_source("text:touch", st.load_profile("electric-mouse")) as source:
    ...     source.read(0).image.shape
    (64, 64)
    """
    opener, rest = find_opener("smarttouch.sources", url, SourceError, Source, ("rest", "profile"))
    rest, told = read_options(opener, rest, SourceError, but=("light_on_dark",))
    given = given_options(opener, url, options, SourceError)
    given = joined_options(url, given, told, SourceError)
    if light_on_dark and "light_on_dark" in inspect.signature(opener).parameters:
        given["light_on_dark"] = True
    source: Source = opener(rest, profile, **given)
    source.url = url
    return source
