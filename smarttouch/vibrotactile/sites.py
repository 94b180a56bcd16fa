"""Selection of the electrodes that pulse."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.electrodes import parse_ranges
from smarttouch.errors import ScheduleError, SmartTouchError
from smarttouch.profile import Profile
from smarttouch.stimulation.points import perceived_at


def disc(profile: Profile, radius_mm: float | None = None) -> NDArray[np.intp]:
    """Return the driven electrodes in the middle of the array, (S,), ascending: the nearest, and
    all within a radius, by default one pitch."""
    electrodes = profile.electrodes
    off_mm = electrodes.position_mm[profile.driven] - electrodes.position_mm.mean(axis=0)
    away_mm = np.hypot(off_mm[:, 0], off_mm[:, 1])
    radius = electrodes.pitch_mm if radius_mm is None else radius_mm
    return np.asarray(profile.driven[away_mm <= max(radius, away_mm.min()) + 1e-9])


def stimulated(profile: Profile, afferent: Afferent, sites: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the electrodes whose stimulation of a class is perceived at sites, (S',).

    They differ from the sites where the profile shifts the class (paper, Section III-B.4), and are
    fewer where the array ends.
    """
    places = perceived_at(profile, afferent)
    if places is None:
        return sites
    there = np.flatnonzero(np.isin(places, sites))
    return np.asarray(np.intersect1d(there, profile.driven))


def chosen(profile: Profile, sites: Collection[int]) -> NDArray[np.intp]:
    """Return the sites that were named, each once, (S,), ascending."""
    if len(sites) == 0:
        raise ScheduleError("no site is to pulse: choose at least one", about="site")
    count, masked = len(profile.electrodes), profile.output.masked
    for each in sites:
        if not 0 <= each < count or each in masked:
            without = f" without {', '.join(map(str, sorted(masked)))}" if masked else ""
            raise ScheduleError(
                f"site {each} cannot pulse: {profile.name} has sites 0 to {count - 1}{without}",
                about="site",
                electrode=each,
            )
    return np.unique(np.array(list(sites), np.intp))


def parse_places(
    profile: Profile, sites: str | None, radius_mm: float | None
) -> NDArray[np.intp] | list[int]:
    """Return the electrodes that a list such as 27,28,35-36 names, or all, or a `disc`."""
    if sites is not None and radius_mm is not None:
        message = "sites and a radius both say what pulses: give one of them"
        raise SmartTouchError(message, about="sites")
    if radius_mm is not None and not radius_mm >= 0:
        message = f"a radius of {radius_mm:g} mm is not possible: give 0 or more"
        raise SmartTouchError(message, about="radius_mm")
    if sites is None:
        return disc(profile, radius_mm)
    if sites == "all":
        return profile.driven
    named: list[int] = []
    for low, high in parse_ranges(sites, "sites"):
        # The first site that there is not is refused; those after it need no room.
        named += range(low, min(high, max(low, len(profile.electrodes))) + 1)
    return named
