"""Discrimination thresholds of a frequency sense, in closed form."""

import math

import numpy as np
from scipy.special import ndtr

from smarttouch.experiments.observers import Interval, Nerve


def weber_fraction(sense, standard_hz, ratio):
    """Return how much higher a comparison is judged so in 75 %; infinite if none is."""
    n, limit_hz = sense.sharpness, sense.believable_hz(ratio)
    left = (standard_hz**-n + limit_hz**-n) * (1 + sense.weber) ** -n - limit_hz**-n
    return float(left ** (-1 / n) / standard_hz - 1) if left > 0 else math.inf


def chance_higher(sense, standard_hz, comparison_hz, ratio):
    """Return the probability that the comparison is judged faster, if both have that ratio."""
    perceived = [sense.perceived_hz(each, ratio) for each in (comparison_hz, standard_hz)]
    return float(ndtr(math.log(perceived[0] / perceived[1]) / (math.sqrt(2) * sense.spread)))


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
