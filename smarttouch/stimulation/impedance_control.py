"""Impedance control: keeps the charge or energy of pulses constant while skin impedance drifts.

A current source near its compliance voltage delivers less than the requested charge. At constant
current, a higher impedance increases the energy. The paper keeps energy constant (Section IV-B).
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.stimulation.scan_sequence import ScanSequence, round_charge_balanced
from smarttouch.stimulation.slots import Slots

NEAR = 0.92  # share of the compliance voltage above which a source counts as saturated
FASTEST_FALL = 0.8  # smallest factor by which one observation changes a site's current
FASTEST_RISE = 1.05
"""Largest factor by which one observation changes a site's current. At 50 Hz, a current can double
in 0.3 s."""
RESERVED = 0.5
"""Initial share of the requested current if energy is held constant. The current rises to the full
request when impedance falls to a quarter of its first value."""
FAINTEST_ENERGY = RESERVED / 4
"""Smallest share of the requested current if energy is held constant. The current falls to this
share when impedance rises to 16 times its first value."""
WORTHWHILE = 0.999  # larger scale factors are not applied, because they are too close to 1

Array = NDArray[np.float64]
Hold = Literal["charge", "energy"]  # quantity that is kept constant


class ImpedanceControl:
    """Controller of currents and pulse widths, by the measured voltage of each site.

    If ``hold`` is "charge", pulses near the compliance voltage become weaker and longer. The board
    must allow different pulse widths in a scan. If ``hold`` is "energy", currents are multiplied by
    `RESERVED` and by √(first impedance / present impedance), together by at most 1.
    """

    def __init__(self, profile: Profile, hold: Hold, compliance_v: float) -> None:
        sites = len(profile.electrodes)
        self._limits = profile.limits
        self.holds: Hold = hold
        self._switched = profile.output.kind != "weighted"
        self._near_v = NEAR * compliance_v
        longest = profile.pulse.width_us / profile.limits.pulse_us
        # Lower bound of `_highest_ua`. At this bound, pulses of full intensity have the longest
        # width. A lower value would not change them, and would take longer to rise again.
        self._least_ua = longest * np.asarray(profile.threshold_ma, np.float64) * 1000
        self._highest_ua = np.full(sites, np.inf)
        self._first_kohm = np.full(sites, np.nan)
        self._factor = np.full(sites, RESERVED if hold == "energy" else 1.0)
        self._limited = np.zeros(sites, np.bool_)

    @property
    def limited(self) -> tuple[int, ...]:
        """Sites whose charge or energy varies, because pulses cannot be longer or stronger."""
        return tuple(np.flatnonzero(self._limited).tolist())

    def observe(self, sequence: ScanSequence, volts: NDArray[np.float32]) -> None:
        """Update the estimates from the voltage of the source at the end of each pulse, (S,) V."""
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
            # Limit the rise, because impedance falls suddenly when a finger returns.
            wanted = np.fmin(wanted, FASTEST_RISE * self._factor[site])
            self._factor[site] = np.clip(wanted, FAINTEST_ENERGY, 1.0)
            return
        # The current of a saturated source is unknown, so reduce the requested current stepwise.
        base_ua = np.where(near, peak_ua, self._highest_ua[site])
        ratio = peak_ua * self._near_v / needed_v / base_ua
        highest_ua = np.where(
            np.isfinite(base_ua), base_ua * np.clip(ratio, FASTEST_FALL, FASTEST_RISE), np.inf
        )
        self._highest_ua[site] = np.maximum(highest_ua, self._least_ua[site])

    def apply(self, slots: Slots) -> Slots:
        """Return slots with adapted currents and widths, in integer µA and µs. Currents sum to zero
        in each slot. No current rises, and no pulse exceeds the charge limit."""
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
            # With a smaller factor a current would round to zero and insulate its electrode.
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
