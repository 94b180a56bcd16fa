"""Policy of sharing slots between points, and the profiles that allow none."""

from typing import NamedTuple

from smarttouch.afferent import Afferent
from smarttouch.profile import Profile


class SlotPolicy(NamedTuple):
    """Policy of sharing slots between points."""

    afferents: tuple[Afferent, ...] = ()
    # Whether each frame's currents are searched for, for as few slots as possible, which takes
    # milliseconds; else kernels are summed of which no subset breaks a bound.
    planned: bool = True


NO_SHARING = SlotPolicy()


def unsupported_reason(profile: Profile) -> tuple[str, str] | None:
    """Return a profile's key and the reason why its board shows only single points, or None."""
    if (kind := profile.output.kind) != "weighted":
        return "output.kind", f"the board is {kind}, with one source for all electrodes"
    if profile.kernels.objective == "finger":
        return "kernels.objective", (
            "kernels.objective is 'finger', and what points do together is proved at nodes"
        )
    if profile.pulse.carrier == "width":
        return "pulse.carrier", "pulse.carrier is 'width', one for all points of a slot"
    if not profile.shares:
        return "frames.share", (
            "frames.share is not on, or limits.total_ma is not set, which bounds their current"
        )
    return None
