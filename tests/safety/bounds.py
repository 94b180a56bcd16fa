"""Limits of a profile as exact integers and fractions, computed from their definitions.

No module of the oracle may import `smarttouch.stimulation.safety_gate`.
"""

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np

NS = 10**9
WHOLE = 10**9
"""Full intensity, in parts per billion (ppb)."""
FREE_RISE = 1_000
"""Tolerance of the ramp for rounding errors, ppb."""
TIMES_ITS_SHARE = 4
"""Strength is at most this factor times the relative charge, which is 1 for a full pulse."""
LATE_NS = 100_000_000
"""Delay after which a sequence is dropped. Strength may exceed the ramp by the rise in this time,
so that a late sequence can catch up."""
LONGEST_PERIOD_US = 60_000_000
LATEST_NS = 2**62
LEAST_DISCHARGE_US = 20
STRONG_A_SECOND = 1_500
MEAN_UA = 500
NET_PC = 50 * 10**6
"""Largest net charge of an electrode in a second, pC: a mean of 50 µA."""
LEVEL_KEPT_NS = 15 * NS
"""Time without current after which the ramp's level falls to zero."""
LONGEST_SHARE_US = 40_000
"""Longest time over which a single sequence must keep `STRONG_A_SECOND` and `MEAN_UA`. If the
sequence has a shorter period, this time is its period."""
TOTAL_MA = 10
DENSITY_UC_CM2 = 100
PC_MM2 = 10**4
"""Charge density of 1 µC/cm², in pC/mm²."""
SHANNON_K = Decimal("1.75")
SESSION_S = 3_600
SESSION_MC = 1_800
PC_IN_MC = 10**9
RECHARGE_US = 20_000
RECHARGE_PC = 4 * 500_000
RECHARGE_UA = 500
PI = Decimal("3.14159265358979323846264338327950288419716939937510")


def dec(value):
    """Convert a float to a fraction by its decimal notation: 2.4 becomes exactly 12/5."""
    return Fraction(repr(float(value)))


def exact(value):
    """Convert a float to the fraction that equals its binary value."""
    return Fraction(float(value))


def area_mm2(array):
    """Return the area of one electrode, mm². A point counts as a disc of 1 mm diameter."""
    first, second = (Decimal(repr(float(size))) for size in array.size_mm)
    if array.shape == "point":
        return PI / 4
    if array.shape == "rectangle":
        return first * second
    return PI / 4 * (first**2 - second**2)


def charge_pc(charge_uc, area, density_uc_cm2):
    """Return the largest pulse charge, pC, within the limits of charge, density and Shannon."""
    with localcontext(prec=60):
        own = Decimal(repr(float(charge_uc))) * 10**6
        if area is None:
            return math.floor(own)
        density = min(Decimal(repr(float(density_uc_cm2))), DENSITY_UC_CM2)
        shannon = (10**SHANNON_K * area / 100).sqrt() * 10**6
        return math.floor(min(own, area * density * PC_MM2, shannon))


@dataclass(frozen=True)
class Bounds:
    """Limits for the sequences of a display.

    ``electrode_ua``, ``strong_ua`` and ``recharge_ua`` have a value for each electrode: its largest
    current, the smallest current of a perceptible pulse, and the largest recharge current. The last
    two are None if thresholds are unknown. A full pulse is ``full_ua`` for ``usual_us``.
    ``source_pc`` limits the charge of all cathodes of a board with one source, because a single
    electrode carries it if the others lose contact. ``session_pc`` holds for each electrode.
    """

    electrodes: int
    rate_hz: Fraction
    duty: Fraction
    pulse_us: int
    usual_us: int
    electrode_ua: tuple
    total_ua: int
    charge_pc: int
    full_ua: Fraction
    ramp_ns: int
    strong_ua: tuple | None
    recharge_ua: tuple | None
    session_us: int
    session_pc: int
    source_pc: int | None = None

    @property
    def rounding_ua(self):
        """Largest rounding error of the electrode that balances the others, µA."""
        return Fraction(self.electrodes, 2) + 1

    @property
    def late_rise(self):
        """Rise of the ramp in `LATE_NS`, ppb."""
        return LATE_NS * WHOLE // self.ramp_ns

    @property
    def full_pc(self):
        """Charge of a full pulse, pC."""
        return self.full_ua * self.usual_us

    def strength_ppb(self, ppb, peak_pc):
        """Return a sequence's strength, ppb, from its intensity and its largest pulse charge."""
        share = math.ceil(WHOLE * Fraction(peak_pc) / self.full_pc)
        return min(WHOLE, max(share, min(ppb, TIMES_ITS_SHARE * share)))

    @property
    def most_passes(self):
        """Largest number of passes that may begin in a second plus `LATE_NS`."""
        return math.ceil(self.rate_hz * (NS + LATE_NS) / NS) + 1

    @classmethod
    def of(cls, profile):
        """Return the bounds of a profile."""
        return cls._made(
            profile.limits,
            len(profile.electrodes),
            max(exact(each) for each in profile.full_ma),
            [exact(each) for each in profile.threshold_ma],
            area_mm2(profile.electrodes),
            profile.output.kind != "weighted",
            profile.output.masked,
            profile.pulse.width_us,
        )

    @classmethod
    def of_limits(cls, limits):
        """Return the bounds of a `SafetyLimits` that was made without a profile."""
        thresholds = limits.threshold_ma
        if thresholds is not None:
            thresholds = [exact(x) for x in np.broadcast_to(thresholds, (limits.electrodes,))]
        area = Decimal(repr(float(np.min(limits.area_mm2))))
        return cls._made(
            limits, limits.electrodes, exact(limits.full_ma),
            thresholds, area,
            limits.one_source, limits.masked, limits.width_us,
        )  # fmt: skip

    @classmethod
    def _made(cls, limits, electrodes, full_ma, thresholds, area, one_source, masked, usual_us):
        own = limits.electrode_ma or [limits.current_ma] * electrodes
        total = TOTAL_MA if limits.total_ma is None else min(dec(limits.total_ma), TOTAL_MA)
        total = min(total, dec(limits.current_ma)) if one_source else total
        known = thresholds is not None
        return cls(
            electrodes=electrodes,
            rate_hz=dec(limits.rate_hz),
            duty=dec(limits.duty),
            pulse_us=math.floor(dec(limits.pulse_us)),
            usual_us=max(
                1, math.floor(min(dec(limits.pulse_us), dec(usual_us or limits.pulse_us)))
            ),
            electrode_ua=tuple(
                0 if index in masked else math.floor(1000 * min(dec(limits.current_ma), dec(each)))
                for index, each in enumerate(own)
            ),
            total_ua=math.floor(1000 * total),
            charge_pc=charge_pc(limits.charge_uc, area, limits.density_uc_cm2),
            full_ua=1000 * full_ma,
            ramp_ns=round(dec(limits.ramp_s) * NS),
            strong_ua=tuple(math.ceil(500 * each) for each in thresholds) if known else None,
            recharge_ua=tuple(
                0 if index in masked else min(RECHARGE_UA, math.floor(100 * each))
                for index, each in enumerate(thresholds)
            )
            if known
            else None,
            session_us=math.floor(10**6 * min(SESSION_S, dec(limits.session_s))),
            session_pc=math.floor(PC_IN_MC * min(SESSION_MC, dec(limits.session_mc))),
            source_pc=math.floor(dec(limits.charge_uc) * 10**6) if one_source else None,
        )
