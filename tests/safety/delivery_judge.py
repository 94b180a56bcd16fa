"""The judge of what flowed: the pulses in an emulator's books, by the limits' definitions."""

from dataclasses import dataclass

import numpy as np

from smarttouch.emulator.firmware import read_slots
from smarttouch.emulator.skin import SPREAD

from .bounds import MEAN_UA, STRONG_A_SECOND

SHARED = (1 + SPREAD) / (1 - SPREAD)
"""How much more than planned an electrode may carry that shares its pole with others.

One source's current divides by the impedances of a pole, which differ in the emulated skin by
``SPREAD`` each way. The best of many carries at most this much more than the average of the
others, 1.353; that of an electrode alone in its pole is the source's own.
"""
ROUNDING_UA = 0.5
"""Books hold whole µA."""
CLOSE = 1 + 1e-5
"""Books hold charges in single precision."""
BURST = 1 + 0.1 + 0.04
"""Shares of a second that may crowd into one of the board's: what 100 ms of lateness moves, and
one sequence, which brings at most what 40 ms allow."""
SECOND_US = 10**6


@dataclass(frozen=True)
class Pulses:
    """Pulses in the order of time, (N,) and (N, E).

    ``time_us`` is None where no time is known, ``width_us`` where it follows from charge alone.
    """

    current_ua: np.ndarray
    charge_pc: np.ndarray
    width_us: np.ndarray | None = None
    time_us: np.ndarray | None = None

    @classmethod
    def of_books(cls, folder):
        """Return those in a folder that an emulator kept its books in."""
        slots = read_slots(folder)
        return cls(
            slots["current_ua"].astype(np.float64),
            slots["charge_uc"].astype(np.float64) * 1e6,
            time_us=slots["time_us"],
        )

    @classmethod
    def taken(cls, numbers, width_us, current_ua):
        """Return those that `SimulatedDriver.take_pulses` gave."""
        current_ua = current_ua.astype(np.float64)
        return cls(current_ua, current_ua * width_us[:, None], width_us)


def judge_pulses(pulses, bounds):
    """Return the names of all limits that pulses break."""
    if not len(pulses.current_ua):
        return []
    current_ua, charge_pc = np.abs(pulses.current_ua), np.abs(pulses.charge_pc)
    allowance, every_ua = _allowance(pulses), bounds.electrodes * ROUNDING_UA
    totals_ua = np.maximum(pulses.current_ua, 0).sum(axis=1)
    if pulses.width_us is None:
        # A mean current and its charge tell the width, as closely as whole µA do.
        rounding_pc = 0
        keeps_width = charge_pc <= (current_ua + ROUNDING_UA) * bounds.pulse_us * CLOSE
    else:
        rounding_pc = ROUNDING_UA * pulses.width_us[:, None]
        keeps_width = pulses.width_us <= bounds.pulse_us * CLOSE
    kept = {
        "current": current_ua <= np.array(bounds.electrode_ua) * allowance + ROUNDING_UA,
        "total": totals_ua <= bounds.total_ua * CLOSE + every_ua,
        "charge": charge_pc <= bounds.charge_pc * allowance + rounding_pc,
        "width": keeps_width,
        "balance": np.abs(pulses.current_ua.sum(axis=1)) <= every_ua,
    }
    if pulses.time_us is not None:
        kept["strong in a second"] = _keeps_strong(pulses, bounds)
        kept["mean in a second"] = _keeps_mean(pulses)
    return [name for name, keeps in kept.items() if not np.all(keeps)]


def _allowance(pulses):
    """Return how much more than planned each electrode may carry in each pulse, (N, E)."""
    current = pulses.current_ua
    poles = [(current > 0).sum(axis=1), (current < 0).sum(axis=1)]
    shares = np.where(current > 0, poles[0][:, None], poles[1][:, None]) > 1
    return np.where(shares, SHARED, CLOSE)


def _keeps_strong(pulses, bounds):
    if bounds.strong_ua is None:
        return True
    least_ua = np.array(bounds.strong_ua) * _allowance(pulses) + ROUNDING_UA
    strong = np.abs(pulses.current_ua) >= least_ua
    most = _most_in_a_second(pulses.time_us, strong.astype(np.float64))
    return most <= STRONG_A_SECOND * BURST


def _keeps_mean(pulses):
    planned_pc = np.abs(pulses.charge_pc) / _allowance(pulses)
    return _most_in_a_second(pulses.time_us, planned_pc) <= MEAN_UA * SECOND_US * BURST


def _most_in_a_second(time_us, amounts):
    """Return the largest sum of any electrode's amounts (N, E) over any second."""
    sums = np.vstack([np.zeros(amounts.shape[1]), np.cumsum(amounts, axis=0)])
    first = np.searchsorted(time_us, time_us - SECOND_US, side="right")
    return float((sums[1:] - sums[first]).max())
