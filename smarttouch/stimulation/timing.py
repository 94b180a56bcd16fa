"""Scan timing fixed by a board."""

import math
from dataclasses import dataclass

from smarttouch.errors import ScheduleError
from smarttouch.profile import Profile


@dataclass(frozen=True)
class ScanTiming:
    """Scan timing fixed by a board; the defaults leave all to the host."""

    width_us: int | None = None  # the only pulse width, if fixed
    discharge_us: int | None = None  # the only discharge time, if fixed
    slot_extra_us: float = 0.0  # time of a slot beyond pulse and discharge
    scan_us: float = 0.0  # time of a scan beyond its slots
    every_electrode: bool = False  # whether idle electrodes take a slot too
    in_index_order: bool = False  # whether the board scans by electrode number
    own_widths: bool = True  # whether each slot may have its own pulse width
    whole_hz: bool = False  # whether its rate is a whole number of hertz
    load: float = 1.0  # share of the period that a scan may fill

    def shortest_period_us(
        self, slots: int, electrodes: int, width_us: float, discharge_us: float
    ) -> int:
        """Return the shortest period of a scan of active points, µs; times of slots are means."""
        taken = electrodes if self.every_electrode else slots
        busy_us = taken * (width_us + discharge_us + self.slot_extra_us) + self.scan_us
        return self.possible_period_us(busy_us / self.load)

    def possible_period_us(self, period_us: float) -> int:
        """Return the shortest period possible on the board that is not below this one, µs.

        A rate of f whole hertz is a period of 1e6/f rounded up: ``round(1e6 / period)`` gives f.
        """
        period = math.ceil(period_us)
        if not self.whole_hz or period <= 1:
            return period
        # The largest f whose period, rounded up, is no shorter.
        rate_hz = 999_999 // (period - 1)
        if not rate_hz:
            raise ScheduleError(
                f"a scan takes {period / 1e6:.2f} s, and the board scans once a second at the "
                "slowest: lower pulse.discharge_us or the number of electrodes",
                about="period_us",
                remedy="pulse.discharge_us",
            )
        return -(-1_000_000 // rate_hz)

    def check(self, profile: Profile) -> None:
        """Raise a ScheduleError unless a profile's pulses suit the board."""
        for key, fixed in (("width_us", self.width_us), ("discharge_us", self.discharge_us)):
            asked = getattr(profile.pulse, key)
            if fixed is not None and asked != fixed:
                raise ScheduleError(
                    f"the profile's pulse.{key} is {asked} µs, the board's is always {fixed} µs: "
                    f"set pulse.{key} = {fixed}",
                    about=f"pulse.{key}",
                    remedy=f"pulse.{key} = {fixed}",
                )
        if profile.pulse.carrier == "width" and not self.own_widths:
            raise ScheduleError(
                "pulse.carrier 'width' needs a pulse width of its own for each slot, and this "
                "board has one for all: set pulse.carrier = 'height'",
                about="pulse.carrier",
                remedy="pulse.carrier = 'height'",
            )
