"""Discrimination thresholds of a frequency sense, in closed form."""

import math

from scipy.special import ndtr


def weber_fraction(sense, standard_hz, ratio):
    """Return how much higher a comparison is judged so in 75 %; infinite if none is."""
    n, limit_hz = sense.sharpness, sense.believable_hz(ratio)
    left = (standard_hz**-n + limit_hz**-n) * (1 + sense.weber) ** -n - limit_hz**-n
    return float(left ** (-1 / n) / standard_hz - 1) if left > 0 else math.inf


def chance_higher(sense, standard_hz, comparison_hz, ratio):
    """Return the probability that the comparison is judged faster, if both have that ratio."""
    perceived = [sense.perceived_hz(each, ratio) for each in (comparison_hz, standard_hz)]
    return float(ndtr(math.log(perceived[0] / perceived[1]) / (math.sqrt(2) * sense.spread)))
