"""Short sequences and their limits, for tests of the oracle with four electrodes."""

from fractions import Fraction

import numpy as np

from smarttouch.stimulation.scan_sequence import ScanSequence

from .bounds import NS, Bounds

FULL = Bounds(
    electrodes=4, rate_hz=Fraction(100), duty=Fraction(1, 2), pulse_us=200, usual_us=200,
    electrode_ua=(3000, 3000, 3000, 700), total_ua=3500, charge_pc=400_000, full_ua=Fraction(3000),
    ramp_ns=NS // 2, strong_ua=(600, 600, 600, 300), recharge_ua=(120, 120, 120, 60),
    session_us=600 * 10**6, session_pc=10**12,
)  # fmt: skip


def sequence(rows, *, width=100, discharge=50, period=20_000, intensity=1.0, time_ns=NS, **other):
    current = np.array(rows, np.int16).reshape(-1, 4)
    slots = len(current)
    made = ScanSequence(
        current, np.broadcast_to(np.array(width, np.uint16), (slots,)),
        np.broadcast_to(np.array(discharge, np.uint16), (slots,)), np.zeros(slots, np.uint16),
        period, intensity, time_ns, other.pop("vibration", None),
    )  # fmt: skip
    for name, value in other.items():
        object.__setattr__(made, name, value)
    return made


def pair(first, count=1):
    """Return ``count`` slots: electrode 0 carries ``first`` µA, electrode 1 the opposite."""
    return [[first, -first, 0, 0]] * count
