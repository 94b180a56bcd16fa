"""Rates of pulses by the scan timing of a board, and rate and intensity by finger force."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.profile import ForceLaw, Profile


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
        self,
        slots: int,
        electrodes: int,
        width_us: float,
        discharge_us: float,
        least_us: float = 0.0,
    ) -> int:
        """Return the shortest period of a scan of active points that is not below ``least_us``, µs;
        times of slots are means."""
        taken = electrodes if self.every_electrode else slots
        busy_us = taken * (width_us + discharge_us + self.slot_extra_us) + self.scan_us
        return self.possible_period_us(max(least_us, busy_us / self.load))

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
                "slowest: lower pulse.discharge_us or the number of electrodes"
            )
        return -(-1_000_000 // rate_hz)

    def check(self, profile: Profile) -> None:
        """Raise a ScheduleError unless a profile's pulses suit the board."""
        for key, fixed in (("width_us", self.width_us), ("discharge_us", self.discharge_us)):
            asked = getattr(profile.pulse, key)
            if fixed is not None and asked != fixed:
                raise ScheduleError(
                    f"the profile's pulse.{key} is {asked} µs, the board's is always {fixed} µs: "
                    f"set pulse.{key} = {fixed}"
                )


SLOWEST = 0.2
"""Part of the full rate at the lightest touch of something hard: 10 of 50 Hz, the slowest pulses of
the paper's experiments (Section III-B.2)."""
_ON_TIME = 0.25  # part of its interval: a class that is later than this starts a new grid
_SLOWEST_HZ = 0.1


def force_gate(force_n: float, law: ForceLaw) -> float:
    """Return the intensity at a finger force, in [0, 1].

    Zero below contact, one from full force on, rising linearly or with the logarithm of force in
    between (paper, Section IV-B). A force of NaN is no contact.
    """
    if not force_n > law.contact_n:
        return 0.0
    if force_n >= law.full_n:
        return 1.0
    if law.law == "linear":
        return (force_n - law.contact_n) / (law.full_n - law.contact_n)
    return math.log(force_n / law.contact_n) / math.log(law.full_n / law.contact_n)


def rate_share(pressure: float, softness: float) -> float:
    """Return the fraction of the full pulse rate at a finger pressure, in [0, 1] as `force_gate`.

    SAI afferents encode pressure in their firing rate. Pressed on something hard they fire faster;
    on something soft the rate hardly changes (paper, Section III-B.2, where a constant rate under a
    moving finger felt soft). Softness 1 leaves the rate unchanged, 0 lets it follow force.
    """
    return softness + (1 - softness) * max(SLOWEST, pressure)


def rates_of(
    profile: Profile, afferents: tuple[Afferent, ...], rate_hz: float | None, timing: ScanTiming
) -> dict[Afferent, float]:
    """Return the pulse rate of each class, Hz: `rate_hz` for one, the profile's for two, none for
    all three, which are not due by themselves."""
    pulse, limits = profile.pulse, profile.limits
    rates_hz = {afferents[0]: pulse.rate_hz if rate_hz is None else rate_hz}
    if Afferent.PC in afferents and len(afferents) > 1:
        # All three never pulse by themselves.
        rates_hz = {}
    elif len(afferents) > 1:
        rates_hz = {Afferent.RA: pulse.ra_rate_hz, Afferent.SAI: pulse.sai_rate_hz}
        if rate_hz is not None:
            raise ScheduleError(
                f"one rate of {rate_hz:g} Hz is not for several classes at once: set "
                "pulse.ra_rate_hz and pulse.sai_rate_hz of the profile"
            )
        if timing.whole_hz or timing.every_electrode or timing.in_index_order:
            raise ScheduleError(
                "natural mode pulses at two rates, and this board scans all electrodes at "
                "one: choose RA or SAI"
            )
    for each_hz in rates_hz.values():
        if not _SLOWEST_HZ <= each_hz <= limits.rate_hz:
            raise ScheduleError(
                f"a rate of {each_hz:g} Hz is not possible: it must be at least "
                f"{_SLOWEST_HZ:g} Hz and at most the profile's limit of {limits.rate_hz:g} Hz"
            )
    return rates_hz


class PulseRates:
    """Time grids of several classes with full rates in Hz, merged where pulses are due closer
    together than `merge_us`, the shortest period of a sequence."""

    def __init__(self, rates_hz: Mapping[Afferent, float], merge_us: int) -> None:
        self._rates_hz = dict(rates_hz)
        self._merge_us = merge_us
        self._last_ns: dict[Afferent, float] = {}

    def due(
        self, time_ns: int, shares: Mapping[Afferent, float]
    ) -> tuple[tuple[Afferent, ...], int]:
        """Return the classes that pulse now, by shares of full rates, and the µs to the next."""
        now, merge_ns = [], 1000 * self._merge_us
        next_ns = []
        for afferent, rate_hz in self._rates_hz.items():
            interval_ns = 1e9 / (rate_hz * shares[afferent])
            due_ns = self._last_ns.get(afferent, -float("inf")) + interval_ns
            if due_ns - time_ns < merge_ns:
                now.append(afferent)
                if time_ns - due_ns > _ON_TIME * interval_ns:
                    due_ns = time_ns
                self._last_ns[afferent] = due_ns
                due_ns += interval_ns
            next_ns.append(due_ns)
        return tuple(now), max(self._merge_us, round((min(next_ns) - time_ns) / 1000))

    def restart(self) -> None:
        """Restart: all classes are due."""
        self._last_ns.clear()
