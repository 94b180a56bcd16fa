"""Log of the levels at which a person settled, for each profile and mode."""

import json
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_state_path

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import make_folder, owner_only, read_text, unwritable
from smarttouch.profile import Profile

SETTLED_NS = 10_000_000_000  # time of touch after which an unchanged level counts as comfortable


def levels_file(profile: Profile) -> Path:
    """Return the log of a profile: one JSON object in each line, oldest first."""
    return user_state_path("smarttouch", appauthor=False) / "levels" / f"{profile.name}.jsonl"


def read_levels(profile: Profile) -> list[dict[str, Any]]:
    """Return the log: unix_s, mode, level, its current_ma, force_n, and kohm or None."""
    path = levels_file(profile)
    lines = read_text(path, ProfileError).splitlines() if path.exists() else []
    try:
        rows = [dict(json.loads(line)) for line in lines]
        return [
            {**row, "mode": row["mode"], "current_ma": float(row["current_ma"])} for row in rows
        ]
    except (ValueError, TypeError, KeyError):
        raise ProfileError(f"{path} is damaged: rename it to begin a new log") from None


def plot_levels(axes: Any, profile: Profile) -> None:
    """Plot the drift of the comfortable current in each mode on axes of Matplotlib. Raises
    ProfileError if the log is empty."""
    if not (rows := read_levels(profile)):
        raise ProfileError(f"no level of {profile.name} is logged: keep one on a board for a while")
    for mode in dict.fromkeys(row["mode"] for row in rows):
        kept = [row for row in rows if row["mode"] == mode]
        times = [datetime.fromtimestamp(row["unix_s"], UTC) for row in kept]
        axes.plot(times, [row["current_ma"] for row in kept], "o-", label=mode)
    axes.legend(fontsize=7)


class SettledLevels:
    """Levels to offer in a run, at most ``most``, and those at which the person settles in it.

    A level counts for the strongest current that it stands for, should the profile have changed.
    """

    def __init__(self, profile: Profile, most: float) -> None:
        self._profile, self._full_ma = profile, float(profile.full_ma.max())
        shares = {row["mode"]: row["current_ma"] / self._full_ma for row in read_levels(profile)}
        levels = {mode: round(share, 3) for mode, share in shares.items()}
        self.offered: dict[str, float] = {
            mode: level for mode, level in levels.items() if 0 < level <= most
        }
        """Level to offer in each mode."""
        self._asked, self._held_ns, self._time_ns = ("", 0.0), 0, 0
        self._measured: Sequence[Any] = ()
        self._new = ""

    def note(
        self, time_ns: int, mode: str, level: float, force_n: float, observed: Sequence[Any] = ()
    ) -> str:
        """Note a step, with measured sequences and their voltages, (S,) V; return the offer when a
        mode begins, else an empty text."""
        begins = mode != self._asked[0] and mode in self.offered
        self._measured = observed[-1] if observed else self._measured
        held_ns, touches = self._held_ns, level > 0 and force_n >= self._profile.force.contact_n
        goes_on = self._asked == (mode, level)
        self._held_ns = goes_on * (held_ns + touches * (time_ns - self._time_ns))
        self._asked, self._time_ns = (mode, level), time_ns
        if held_ns < SETTLED_NS <= self._held_ns:
            row = {"unix_s": round(time.time()), "mode": mode, "level": level, "force_n": force_n}
            row |= {"current_ma": level * self._full_ma, "kohm": _kohm(*self._measured)}
            self._new += json.dumps(row) + "\n"
        if not begins:
            return ""
        last = f"last time {self.offered[mode]:.2f} was comfortable in mode {mode}"
        return f"{last}: press L to rise to it"

    def save(self) -> None:
        """Append the new levels to the log."""
        path, rows, self._new = levels_file(self._profile), self._new, ""
        try:
            make_folder(path.parent)
            with open(path, "a", encoding="utf-8", opener=owner_only) as file:
                file.write(rows)
        except OSError as failure:
            raise unwritable(ProfileError, path, failure) from None


def _kohm(sequence: Any = None, volts: Any = ()) -> float | None:
    """Return the median over the slots of a measured sequence; None without one."""
    if not len(volts):
        return None
    peak_ua = np.abs(sequence.current_ua.astype(np.float64)).max(axis=1)
    kohm = float(np.median(1000 * np.abs(volts) / np.maximum(peak_ua, 1)))
    return kohm if np.isfinite(kohm) else None
