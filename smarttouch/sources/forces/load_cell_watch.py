"""State of a load cell's readings: fresh, silent, frozen, or missing. Without a clock."""

import math
from collections.abc import Callable

from smarttouch.sources.notes import DeviceWarnings, OutageTracker

FRESH_S = 0.35
"""Age up to which a reading is fresh: enough for cells with ten conversions a second."""
FROZEN_READINGS = 20
FROZEN_S = 2.0
"""Time of equal readings after which a cell is frozen: a converter always has noise."""
SATURATED = (float(-(2**23)), float(2**23 - 1))
"""Ends of the HX711's range: overloaded, or nothing is connected."""


class CellWatch:
    """Tracks the readings of one cell; the time is passed in each call, warnings go to ``notes``.

    ``presses`` says whether a reading means contact: only then are constant readings a fault.
    """

    def __init__(self, title: str, notes: list[str], presses: Callable[[float], bool]) -> None:
        self._title = title
        self._presses = presses
        self._value = math.nan
        self._last_ns: int | None = None
        self._same_since_ns = 0
        self._same = 0
        self._empty = self._saturated = 0
        self._warnings = DeviceWarnings(notes)
        self._silence = OutageTracker(
            self._warnings,
            f"{title}: no reading",
            f"a reading is valid for {FRESH_S:g} s, so ten a second or more are needed",
        )
        self._freeze = OutageTracker(
            self._warnings,
            f"{title}: readings were constant under pressure",
            "it is frozen, or prints too few decimals",
        )
        self._absence = OutageTracker(
            self._warnings, f"{title} was disconnected", "check the cable"
        )

    def take(self, readings: list[float], now_ns: int) -> None:
        """Take new readings, oldest first."""
        for value in readings:
            known = self._count(value)
            if known == self._value:
                self._same += 1
            else:
                self._value, self._same, self._same_since_ns = known, 1, now_ns
        if readings:
            self._silence.update(False, now_ns)
            self._absence.update(False, now_ns)
            self._last_ns = now_ns
            self._freeze.update(self._frozen(now_ns), now_ns, self._same_since_ns)

    def check(self, now_ns: int, garbled: int, last_garbled: str) -> None:
        """Update the state between readings; ``garbled`` is input without a reading."""
        last_ns = self._last_ns
        if last_ns is not None and now_ns - last_ns > FRESH_S * 1e9:
            self._silence.update(True, now_ns, last_ns)
            self._freeze.update(False, last_ns)
        if self._absence.is_on:
            self._absence.update(True, now_ns)
        if garbled:
            times = "once" if garbled == 1 else f"{garbled} times"
            self._warnings.put(
                "garbled", f"{self._title}: input without a reading {times}, last {last_garbled}"
            )

    def lose(self, now_ns: int) -> None:
        """Report that the port is lost, and discard earlier readings."""
        self._absence.update(True, now_ns)
        # A lost port explains the missing readings: no note on silence besides.
        self._silence.update(False, now_ns)
        self._freeze.update(False, now_ns)
        self._last_ns, self._value, self._same = None, math.nan, 0

    def reading(self, now_ns: int) -> float:
        """Return the newest reading; NaN if it is unknown."""
        if self._last_ns is None or now_ns - self._last_ns > FRESH_S * 1e9:
            return math.nan
        return math.nan if self._frozen(now_ns) else self._value

    def _frozen(self, now_ns: int) -> bool:
        return (
            self._same >= FROZEN_READINGS
            and now_ns - self._same_since_ns >= FROZEN_S * 1e9
            and self._presses(self._value)
        )

    def _count(self, value: float) -> float:
        """Return a reading, or NaN for an invalid one, with a note."""
        if value in SATURATED:
            self._saturated += 1
            self._warnings.put(
                "saturated",
                f"{self._title}: at the end of its range, {value:.0f}, in {self._saturated} "
                "readings: overloaded, or not connected",
            )
            return math.nan
        if math.isnan(value):
            self._empty += 1
            self._warnings.put(
                "none", f"{self._title}: {self._empty} of its packets had no reading"
            )
        return value
