"""Trains of pulses of several classes, merged into sequences."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile
from smarttouch.stimulation.timing import ScanTiming

Times = NDArray[np.int64]


def shortest_us(profile: Profile, slots: int, timing: ScanTiming) -> int:
    """Return the shortest sequence with so many slots within the profile's limits, µs."""
    pulse, limits = profile.pulse, profile.limits
    busy_us = timing.shortest_period_us(
        slots, len(profile.electrodes), pulse.width_us, pulse.discharge_us
    )
    within_us = max(slots * pulse.width_us / limits.duty, 1e6 / limits.rate_hz)
    return max(busy_us, timing.possible_period_us(within_us))


def thinned(time_us: Times, least_us: int) -> Times:
    """Return as many of ascending times as possible that are at least an interval apart."""
    kept, free_us = [], -math.inf
    for each in time_us.tolist():
        # Times are whole microseconds: a regular train may tremble by one.
        if each >= free_us - 1:
            kept.append(each)
            free_us = each + least_us
    return np.array(kept, np.int64)


def merged(trains: list[Times], least_us: int) -> tuple[Times, list[NDArray[np.intp]]]:
    """Return the starts of sequences, and for each train the sequence of each of its pulses.

    A pulse that comes sooner than half of the shortest sequence after a sequence's start joins it,
    any other starts a new one: when it is due, or when the sequence before is over. So none is
    moved by more than half of the shortest sequence. Trains are (K,) int64, µs, rising; no two
    times of one train are closer than `least_us`, less a microsecond.
    """
    events = sorted((each, row) for row, train in enumerate(trains) for each in train.tolist())
    begins: list[int] = []
    carried: list[list[int]] = [[] for _ in trains]
    joined: set[int] = set()
    for each, row in events:
        if not begins or row in joined or 2 * (each - begins[-1]) >= least_us:
            begins.append(max(each, begins[-1] + least_us) if begins else each)
            joined = set()
        joined.add(row)
        carried[row].append(len(begins) - 1)
    return np.array(begins, np.int64), [np.array(each, np.intp) for each in carried]
