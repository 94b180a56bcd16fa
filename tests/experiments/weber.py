"""Discrimination thresholds of a frequency sense, in closed form."""

import math

import numpy as np

from smarttouch.experiments.observers import BASE_WEBER, SHARPNESS, Interval, Nerve, believable_hz


def weber_fraction(standard_hz, ratio):
    """Return how much higher a comparison is judged so in 75 %; infinite if none is."""
    n, limit_hz = SHARPNESS, believable_hz(ratio)
    left = (standard_hz**-n + limit_hz**-n) * (1 + BASE_WEBER) ** -n - limit_hz**-n
    return float(left ** (-1 / n) / standard_hz - 1) if left > 0 else math.inf


def ratio_of(finger, bank, afferent, site):
    """Return the ratio of PC to RA spikes that full pulses of a mode evoke at a site."""
    profile = finger.profile
    current_ua = np.rint(1000 * profile.full_ma[site] * bank.kernels(afferent)[site])
    return (
        Nerve(finger)
        .of(
            Interval(
                np.arange(20) * 0.05,
                np.full(20, profile.pulse.width_us, np.float32),
                np.tile(current_ua.astype(np.int16), (20, 1)),
            )
        )
        .ratio
    )
