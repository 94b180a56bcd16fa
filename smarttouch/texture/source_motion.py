"""The pose of any source as the motion of a hand, as an optical mouse has it."""

import math

from smarttouch.profile import DEFAULT_PROFILE, Profile, load_profile
from smarttouch.sources import open_source
from smarttouch.sources.frame import Pose
from smarttouch.sources.source import Source
from smarttouch.texture.motion import Motion

_IMAGE_RESOLUTION_MM = 0.02
"""Jitter at rest of motion found in images; an estimate of ours."""


def open_posed_source(url: str, *, profile: Profile | None = None) -> "SourceMotion":
    """Open any source that knows its pose; its optics are electric-mouse's if none are given."""
    return SourceMotion(open_source(url, profile or load_profile(DEFAULT_PROFILE)))


class SourceMotion(Motion):
    """Motion by the pose of a source, which is closed with it."""

    resolution_mm = _IMAGE_RESOLUTION_MM

    def __init__(self, source: Source) -> None:
        super().__init__(f"the motion of {source.title}")
        self._source = source
        self.notes = source.notes
        self.knows_force = source.knows_force
        self.measures_force = source.measures_force
        self.duration_s = source.duration_s
        self._first: Pose | None = None

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return how far the source is from where it was first; None after its end."""
        given = self._source.read(time_ns)
        if given is None:
            return None
        if self._first is None:
            self._first = given.pose
        # What was seen last may be gone: whether the finger is still there is unknown.
        self.force_n = math.nan if given.stale else given.force_n
        return given.pose.x_mm - self._first.x_mm, given.pose.y_mm - self._first.y_mm

    def close(self) -> None:
        """Close the source."""
        self._source.close()
