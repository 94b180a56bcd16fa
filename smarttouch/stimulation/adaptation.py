"""Adaptation to measured voltages: charge or energy held constant as impedance drifts.

The impedance of an electrode drifts with sweat and pressure. A source near its
greatest voltage then delivers less than asked; and at the same current, more
voltage is more energy (paper, Section IV-B, which holds that constant).
"""

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ScheduleError
from smarttouch.profile import Profile
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.stimulation.slot_sums import round_charge_balanced

NEAR = 0.92  # part of the compliance above which a source counts as saturated
FASTEST_FALL = 0.8
FASTEST_RISE = 1.05
"""Largest ratio of a site's current between observations; at 50 Hz, 0.3 s from half to full."""
RESERVED = 0.5
"""Part of the current asked for with which energy is held from, so that it holds while impedance
falls to a quarter, too: nothing may carry more than was asked for."""
FAINTEST_ENERGY = RESERVED / 4
"""Least part of its current a site keeps to hold energy: 16 times the first impedance."""
WORTHWHILE = 0.999  # factor above which a current is left as it is

Array = NDArray[np.float64]
Hold = Literal["charge", "energy"]  # quantity held constant against drifting impedance


class Adaptation:
    """Estimates the impedance of every site, and adapts currents and widths to it.

    To hold ``charge``, pulses become weaker and as much longer where the source is near its
    compliance, which a board with one pulse width cannot do. To hold ``energy``, they begin with
    `RESERVED` of the current and change by the square root of the change in impedance since the
    first observation, either way; what was asked for is never exceeded.
    """

    def __init__(
        self, profile: Profile, hold: Hold, compliance_v: float, timing: ScanTiming | None = None
    ) -> None:
        self._timing = ScanTiming() if timing is None else timing
        if hold == "charge" and self._timing.width_us is not None:
            raise ScheduleError(
                "hold charge needs longer pulses, and this board's pulses last "
                f"{self._timing.width_us} µs always: hold energy"
            )
        sites = len(profile.electrodes)
        self._limits = profile.limits
        self.holds: Hold = hold
        self._switched = profile.output.kind != "weighted"
        self._near_v = NEAR * compliance_v
        longest = profile.pulse.width_us / profile.limits.pulse_us
        # Below this a limit would change nothing, and only take long to rise again.
        self._least_ua = longest * np.asarray(profile.threshold_ma, np.float64) * 1000
        self._highest_ua = np.full(sites, np.inf)
        self._first_kohm = np.full(sites, np.nan)
        self._factor = np.full(sites, RESERVED if hold == "energy" else 1.0)
        self._limited = np.zeros(sites, np.bool_)

    @property
    def limited(self) -> tuple[int, ...]:
        """Sites whose pulses cannot become longer, or stronger: charge or energy is not held."""
        return tuple(np.flatnonzero(self._limited).tolist())

    def observe(self, sequence: ScanSequence, volts: NDArray[np.float32]) -> None:
        """Update by the source's voltages at the end of each pulse, (S,), of a sequence as sent."""
        peak_ua = _peak_ua(sequence.current_ua)
        known = (peak_ua > 0) & np.isfinite(volts) & (np.asarray(volts) > 0)
        site, peak_ua = sequence.site[known].astype(np.intp), peak_ua[known]
        needed_v = np.asarray(volts, np.float64)[known]
        if self.holds == "charge":
            self._observe_charge(site, peak_ua, needed_v)
        else:
            self._observe_energy(site, peak_ua, needed_v)

    def _observe_charge(self, site: NDArray[np.intp], peak_ua: Array, needed_v: Array) -> None:
        """Update each site's largest current by what its source can just drive."""
        near = needed_v > self._near_v
        highest = self._highest_ua[site]
        # A saturated source shows only that less is needed, not how much: step from its last value.
        base = np.where(near, peak_ua, highest)
        found = base.copy()
        moves = np.isfinite(base)
        possible = peak_ua[moves] * self._near_v / needed_v[moves]
        found[moves] *= np.clip(possible / base[moves], FASTEST_FALL, FASTEST_RISE)
        self._highest_ua[site] = np.maximum(found, self._least_ua[site])

    def _observe_energy(self, site: NDArray[np.intp], peak_ua: Array, needed_v: Array) -> None:
        kohm = needed_v / peak_ua * 1000
        first = np.isnan(self._first_kohm[site]) & (needed_v <= self._near_v)
        self._first_kohm[site[first]] = kohm[first]
        wanted = RESERVED * np.sqrt(self._first_kohm[site] / kohm)
        self._limited[site] = wanted > 1 / WORTHWHILE
        # Nothing comes on suddenly, not even where a lifted finger is back.
        wanted = np.fmin(wanted, FASTEST_RISE * self._factor[site])
        self._factor[site] = np.clip(wanted, FAINTEST_ENERGY, 1.0)

    def apply(self, sequence: ScanSequence) -> ScanSequence:
        """Return the adapted sequence, in whole µA that sum to zero in every slot and whole µs.

        No electrode carries more than in the given one, and no pulse more charge than the limit.
        The period grows where longer pulses need it.
        """
        site = sequence.site.astype(np.intp)
        peak_ua = _peak_ua(sequence.current_ua)
        if self.holds == "charge":
            wanted = np.fmin(self._highest_ua[site] / np.maximum(peak_ua, 1), 1.0)
            longest = np.minimum(sequence.width_us / self._limits.pulse_us, 1.0)
            self._limited[site] = wanted < longest
            factor = np.maximum(wanted, longest)
        else:
            factor = self._factor[site]
        if self._switched:
            factor = np.maximum(factor, _least_that_switches(sequence.current_ua))
        changed = np.flatnonzero(factor < WORTHWHILE)
        if not len(changed):
            return sequence
        current_ua, width_us = sequence.current_ua.copy(), sequence.width_us.copy()
        current_ua[changed] = round_charge_balanced(
            current_ua[changed].astype(np.float64) * factor[changed, None]
        )
        if self.holds == "charge":
            width_us[changed] = self._stretched(
                width_us[changed], peak_ua[changed], _peak_ua(current_ua[changed])
            )
        return replace(
            sequence,
            current_ua=current_ua,
            width_us=width_us,
            period_us=max(sequence.period_us, self._shortest_us(sequence, width_us)),
            proof=None,
        )

    def _stretched(
        self, width_us: NDArray[np.uint16], before_ua: Array, after_ua: Array
    ) -> NDArray[np.uint16]:
        """Return the widths that keep the charge, within the limits."""
        after_ua = np.maximum(after_ua, 1)
        most = np.floor(np.minimum(self._limits.pulse_us, self._limits.charge_uc * 1e6 / after_ua))
        return np.minimum(np.rint(width_us * before_ua / after_ua), most).astype(np.uint16)

    def _shortest_us(self, sequence: ScanSequence, width_us: NDArray[np.uint16]) -> int:
        pulses_us = float(width_us.mean())
        scan_us = self._timing.shortest_period_us(
            sequence.slots, sequence.electrodes, pulses_us, float(sequence.discharge_us.mean())
        )
        within_duty_us = int(width_us.sum(dtype=np.int64)) / self._limits.duty
        return max(scan_us, self._timing.possible_period_us(within_duty_us))


def _peak_ua(current_ua: NDArray[np.int16]) -> Array:
    """Return the strongest current of each slot, (S,) µA (magnitude)."""
    return np.asarray(np.abs(current_ua.astype(np.float64)).max(axis=1))


def _least_that_switches(current_ua: NDArray[np.int16]) -> Array:
    """Return the factor below which scaling a slot would insulate an electrode."""
    magnitude = np.abs(current_ua.astype(np.float64))
    return np.asarray(1 / np.where(magnitude > 0, magnitude, np.inf).min(axis=1))
