"""Finger force from a source other than that of the frames."""

import math
from abc import ABC, abstractmethod
from typing import ClassVar

from smarttouch.base.errors import SourceError
from smarttouch.base.registry import Registry
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Device

LARGEST_FIXED_N = 20.0


class ForceSource(Device, ABC):
    """Source of finger force, opened by its URL."""

    is_live: ClassVar[bool] = True
    """Whether the force is that of a finger that presses now, measured or stated by a person; any
    other opens no current on a board that a finger may touch."""

    @abstractmethod
    def read(self, time_ns: int) -> float:
        """Return the force at a time since the start of the run, N; NaN if it is unknown.

        Never waits and never raises.
        """


FORCES = Registry(
    "smarttouch.forces",
    ForceSource,
    SourceError,
    {
        "fixed": "smarttouch.sources.force:FixedForce",
        "hx711": "smarttouch.sources.load_cell:open_hx711",
        "loadcell": "smarttouch.sources.load_cell:open_load_cell",
    },
)


def open_force(url: str, profile: Profile) -> ForceSource:
    """Open a source of finger force by its URL."""
    opener, rest = FORCES.find(url)
    source: ForceSource = opener(rest, profile)
    FORCES.require_kind(source, url)
    return source


class FixedForce(ForceSource):
    """Constant force, 0 to 20 N, which a person states to be there: ``fixed:N``."""

    def __init__(self, text: str, profile: Profile | None = None) -> None:
        try:
            self._force_n = float(text)
        except ValueError:
            self._force_n = math.nan
        if not 0 <= self._force_n <= LARGEST_FIXED_N:
            raise SourceError(
                f"fixed:{text} is not a force: give newtons from 0 to {LARGEST_FIXED_N:g}, as in "
                "fixed:0.5"
            )
        super().__init__(f"fixed {self._force_n:g} N")

    def read(self, time_ns: int) -> float:
        """Return the force."""
        return self._force_n
