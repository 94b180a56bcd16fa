"""Finger force from a source other than that of the frames."""

import math
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

import numpy as np

from smarttouch.base.errors import SourceError
from smarttouch.base.registry import Registry
from smarttouch.base.tables import read_csv
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Device

LARGEST_FIXED_N = 20.0
LARGEST_RECORDED_N = 100.0  # largest plausible force of a finger; larger numbers are not newtons
_COLUMNS = ("time_s", "force_n")


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
        "recorded": "smarttouch.sources.force:RecordedForce",
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


class RecordedForce(ForceSource):
    """Force from a CSV table, ``recorded:FILE``, linear between its rows, unknown outside of them.

    The columns ``time_s``, since the start of the run and rising, and ``force_n`` are used, others
    are not, so a recorded path will do.
    """

    is_live = False

    def __init__(self, rest: str | Path, profile: Profile | None = None) -> None:
        path = Path(rest)
        super().__init__(f"force of {path.name}")
        table = read_csv(path, SourceError)
        self._time_s, self._force_n = table.numbers(_COLUMNS).T
        beyond = np.flatnonzero(np.abs(self._force_n) > LARGEST_RECORDED_N)
        if len(beyond):
            line, force_n = table.lines[beyond[0]], float(self._force_n[beyond[0]])
            raise SourceError(
                f"{path}, line {line}: {force_n:g} N is more than any finger presses: give newtons"
            )

    def read(self, time_ns: int) -> float:
        """Return the force at a time since the start, N; NaN outside the table."""
        nothing = math.nan
        force_n = np.interp(time_ns / 1e9, self._time_s, self._force_n, nothing, nothing)
        return nothing if np.isnan(force_n) else max(0.0, float(force_n))
