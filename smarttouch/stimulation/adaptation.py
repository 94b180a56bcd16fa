"""Adaptation to measured voltages: charge or energy held constant as impedance drifts.

The impedance of an electrode drifts with sweat and pressure. A source near its
greatest voltage then delivers less than asked; and at the same current, more
voltage is more energy (paper, Section IV-B, which holds that constant).
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.stimulation.scan_sequence import ScanSequence, round_charge_balanced
from smarttouch.stimulation.slots import Slots

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

    def __init__(self, profile: Profile, hold: Hold, compliance_v: float) -> None:
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
        near = needed_v > self._near_v
        if self.holds == "energy":
            kohm = needed_v / peak_ua * 1000
            first = np.isnan(self._first_kohm[site]) & ~near
            self._first_kohm[site[first]] = kohm[first]
            wanted = RESERVED * np.sqrt(self._first_kohm[site] / kohm)
            self._limited[site] = wanted > 1 / WORTHWHILE
            # Nothing comes on suddenly, not even where a lifted finger is back.
            wanted = np.fmin(wanted, FASTEST_RISE * self._factor[site])
            self._factor[site] = np.clip(wanted, FAINTEST_ENERGY, 1.0)
            return
        # A saturated source shows only that less is needed, not how much: step from its last value.
        base_ua = np.where(near, peak_ua, self._highest_ua[site])
        ratio = peak_ua * self._near_v / needed_v / base_ua
        highest_ua = np.where(
            np.isfinite(base_ua), base_ua * np.clip(ratio, FASTEST_FALL, FASTEST_RISE), np.inf
        )
        self._highest_ua[site] = np.maximum(highest_ua, self._least_ua[site])

    def apply(self, slots: Slots) -> Slots:
        """Return the adapted slots, in whole µA that sum to zero in every slot and whole µs.

        No electrode carries more than in the given ones, and no pulse more charge than the limit.
        """
        current_ua, width_us, limits = slots.current_ua, slots.width_us, self._limits
        site, peak_ua = slots.site.astype(np.intp), _peak_ua(current_ua)
        if self.holds == "charge":
            wanted = np.fmin(self._highest_ua[site] / np.maximum(peak_ua, 1), 1.0)
            longest = np.minimum(width_us / limits.pulse_us, 1.0)
            self._limited[site] = wanted < longest
            factor = np.maximum(wanted, longest)
        else:
            factor = self._factor[site]
        if self._switched:
            # Weaker ones would be insulated.
            magnitude = np.abs(current_ua.astype(np.float64))
            least = 1 / np.where(magnitude > 0, magnitude, np.inf).min(axis=1)
            factor = np.maximum(factor, least)
        changed = np.flatnonzero(factor < WORTHWHILE)
        if not len(changed):
            return slots
        weaker_ua = round_charge_balanced(np.float64(factor[changed, None]) * current_ua[changed])
        current_ua, width_us = current_ua.copy(), width_us.copy()
        current_ua[changed] = weaker_ua
        if self.holds == "charge":
            after_ua = np.maximum(_peak_ua(weaker_ua), 1)
            most_us = np.floor(np.minimum(limits.pulse_us, limits.charge_uc * 1e6 / after_ua))
            longer_us = np.rint(width_us[changed] * peak_ua[changed] / after_ua)
            width_us[changed] = np.minimum(longer_us, most_us)
        return slots._replace(current_ua=current_ua, width_us=width_us, proof=None, sums=None)


def _peak_ua(current_ua: NDArray[np.int16]) -> Array:
    """Return the strongest current of each slot, (S,) µA (magnitude)."""
    return np.asarray(np.abs(current_ua.astype(np.float64)).max(axis=1))
