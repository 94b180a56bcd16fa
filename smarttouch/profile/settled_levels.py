"""Log of the intensity levels that a person found comfortable, for each profile and mode."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_state_path

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import make_folder, owner_only, read_text, unwritable
from smarttouch.profile.profile import Profile
from smarttouch.profile.toml_tables import Table

SETTLED_NS = 10_000_000_000  # time of touch after which an unchanged level counts as comfortable


class SettledLevel(Table):
    """Log entry: a comfortable level, and the electrode current, force and impedance at it."""

    time: datetime
    mode: str
    level: float
    current_ma: float
    force_n: float
    kohm: float | None


def levels_file(profile: Profile) -> Path:
    """Return the log of a profile: one JSON object in each line, oldest first."""
    return user_state_path("smarttouch", appauthor=False) / "levels" / f"{profile.name}.jsonl"


def read_levels(profile: Profile) -> list[SettledLevel]:
    """Return the log of a profile. Raises ProfileError if it is damaged."""
    path = levels_file(profile)
    lines = read_text(path, ProfileError).splitlines() if path.exists() else []
    try:
        return [SettledLevel.model_validate_json(line) for line in lines]
    except ValueError:
        raise ProfileError(f"{path} is damaged: rename it to begin a new log") from None


class SettledLevels:
    """Log of a run's comfortable levels. For each mode, it also offers the level that gives the
    current last logged in this mode. A level above ``most`` is not offered."""

    def __init__(self, profile: Profile, most: float) -> None:
        self._profile, self._full_ma = profile, float(profile.full_ma.max())
        shares = {log.mode: log.current_ma / self._full_ma for log in read_levels(profile)}
        self.offered: dict[str, float] = {
            mode: round(share, 3) for mode, share in shares.items() if 0 < round(share, 3) <= most
        }
        """Level to offer in each mode."""
        self._asked, self._held_ns, self._time_ns = ("", 0.0), 0, 0
        self._kohm: float | None = None
        self._new = ""

    def note(
        self, time_ns: int, mode: str, level: float, force_n: float, observed: Sequence[Any] = ()
    ) -> str:
        """Process a step. ``observed`` has the sequences measured since the previous step, each
        with its voltages, (S,) V. If the mode has changed, and there is a level to offer in the
        new mode, return a sentence that offers this level. Otherwise, return ""."""
        begins = mode != self._asked[0] and mode in self.offered
        for sequence, volts in observed:
            peak_ua = np.abs(sequence.current_ua.astype(np.float64)).max(axis=1, initial=1)
            kohm = float(np.median(1000 * np.abs(volts) / peak_ua)) if len(volts) else np.nan
            self._kohm = kohm if np.isfinite(kohm) else None
        held_ns, touches = self._held_ns, level > 0 and force_n >= self._profile.force.contact_n
        goes_on = self._asked == (mode, level)
        self._held_ns = goes_on * (held_ns + touches * (time_ns - self._time_ns))
        self._asked, self._time_ns = (mode, level), time_ns
        if held_ns < SETTLED_NS <= self._held_ns:
            settled = SettledLevel(
                time=datetime.now(UTC), mode=mode, level=level, force_n=force_n,
                current_ma=level * self._full_ma, kohm=self._kohm,
            )  # fmt: skip
            self._new += settled.model_dump_json() + "\n"
        offered = f"level {self.offered.get(mode, 0):.2f} was comfortable last time in mode {mode}"
        return f"{offered}: press L to rise to it" if begins else ""

    def save(self) -> None:
        """Append the new levels to the log."""
        path, rows, self._new = levels_file(self._profile), self._new, ""
        try:
            make_folder(path.parent)
            with open(path, "a", encoding="utf-8", opener=owner_only) as file:
                file.write(rows)
        except OSError as failure:
            raise unwritable(ProfileError, path, failure) from None
