"""Modes, classes, sites and other choices, as options name them."""

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, TypeVar

from smarttouch.afferent import Afferent, Mode
from smarttouch.errors import SmartTouchError, not_offered, require_within

if TYPE_CHECKING:
    from smarttouch.profile import Profile

Choice = TypeVar("Choice", bound=str)


def parse_mode(mode: str) -> Mode:
    """Return a mode by its name; only modes that images can drive."""
    offered = [each for each in Mode if each is not Mode.COLOR]
    for each in offered:
        if mode.lower() == each.value.lower():
            return each
    raise not_offered("mode", mode, offered)


def parse_choice(option: str, text: str, choices: Iterable[Choice]) -> Choice:
    """Return the choice that an option names, in capitals or not."""
    known = list(choices)
    if text.lower() not in known:
        raise not_offered(option, text, known)
    return next(each for each in known if each == text.lower())


def parse_afferent(mode: str) -> Afferent:
    """Return a class of afferents by its name."""
    if mode.upper() not in Afferent.__members__:
        raise not_offered("mode", mode, Afferent.__members__)
    return Afferent[mode.upper()]


def require_site(profile: "Profile", site: int) -> None:
    """Raise unless a profile's array has such a site."""
    words = f"site {site} of {profile.name}"
    require_within(SmartTouchError, "site", site, 0, len(profile.electrodes) - 1, words)


def require_answers(
    simulate: bool, board_url: str, boards: tuple[str, ...], error: type[SmartTouchError]
) -> None:
    """Raise unless a person at a keyboard can answer, or a simulation on such boards."""
    if simulate and not board_url.startswith(boards):
        raise error(
            f"a simulation answers for nobody: no current of its flows through {board_url!r}, only "
            f"through {' or '.join(boards)}",
            about="board",
        )
    if not simulate and not sys.stdin.isatty():
        message = "there is no keyboard to answer on: use a terminal, or simulate"
        raise error(message, about="keyboard", remedy="simulate")
