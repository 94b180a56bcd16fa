"""Whose points share slots: what ``--scan`` asks for."""

from typing import TYPE_CHECKING

from smarttouch.cli.files import parse_choice
from smarttouch.primary import Primary

if TYPE_CHECKING:
    from smarttouch.profile import Profile
    from smarttouch.stimulation.frames import Sharing


def parse_scan(scan: str, profile: "Profile", hold: str | None = None) -> "Sharing":
    """Return the classes that ``--scan`` lets share slots, and how.

    By itself RA, by kernels that are proved for all frames and only added up: those
    of SAI would have to be found anew for each frame, which takes longer than
    there is between two pulses. None where ``--hold`` is, or the board cannot.
    """
    from smarttouch.stimulation.frames import NO_SHARING, Sharing, why_not

    chosen = parse_choice("--scan", scan, ("points", "frame", "auto"))
    if chosen == "frame":
        return Sharing(tuple(Primary), planned=True)
    if chosen == "points" or hold or why_not(profile) is not None:
        return NO_SHARING
    return Sharing((Primary.RA,), planned=False)
