"""Check of delivered pulses against the definitions of the limits."""

from dataclasses import dataclass

import numpy as np

from smarttouch.emulator.firmware_base import read_slots
from smarttouch.emulator.skin import SPREAD

from .bounds import MEAN_UA, STRONG_A_SECOND

SHARED = (1 + SPREAD) / (1 - SPREAD)
"""Largest ratio of delivered to planned current, for electrodes that share a polarity: 1.353.

A single source divides its current among them by their impedances, which differ by up to ±`SPREAD`
in the emulated skin. A single cathode or anode carries the complete current of the source.
"""
ROUNDING_UA = 0.5
"""Rounding error of currents in delivery logs, which hold integer µA."""
CLOSE = 1 + 1e-5
"""Tolerance for charges in delivery logs, which have single precision."""
BURST = 1 + 0.1 + 0.04
"""Largest allowed sum over a second, in multiples of the limit. A delay of up to 100 ms adds 0.1. A
sequence that delivers the current of 40 ms at once adds 0.04."""
SECOND_US = 10**6


@dataclass(frozen=True)
class Pulses:
    """N delivered pulses of E electrodes, in order of time; arrays are (N,) and (N, E).

    ``time_us`` is None if times are unknown; ``width_us`` is None if widths are unknown.
    """

    current_ua: np.ndarray
    charge_pc: np.ndarray
    width_us: np.ndarray | None = None
    time_us: np.ndarray | None = None

    @classmethod
    def of_books(cls, folder):
        """Read the pulses from the folder of an emulator's delivery log."""
        slots = read_slots(folder)
        return cls(
            slots["current_ua"].astype(np.float64),
            slots["charge_uc"].astype(np.float64) * 1e6,
            time_us=slots["time_us"],
        )

    @classmethod
    def taken(cls, numbers, width_us, current_ua):
        """Convert the pulses that `SimulatedDriver.take_pulses` returned."""
        current_ua = current_ua.astype(np.float64)
        return cls(current_ua, current_ua * width_us[:, None], width_us)


def judge_pulses(pulses, bounds):
    """Return the names of all limits that the pulses exceed."""
    if not len(pulses.current_ua):
        return []
    current_ua, charge_pc = np.abs(pulses.current_ua), np.abs(pulses.charge_pc)
    allowance, every_ua = _allowance(pulses), bounds.electrodes * ROUNDING_UA
    totals_ua = np.maximum(pulses.current_ua, 0).sum(axis=1)
    if pulses.width_us is None:
        # Width is charge divided by mean current; allow for the rounding of currents.
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
    """Return the largest permitted ratio of delivered to planned current, (N, E)."""
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
    """Return the largest sum of ``amounts``, (N, E), over any second, for any electrode."""
    sums = np.vstack([np.zeros(amounts.shape[1]), np.cumsum(amounts, axis=0)])
    first = np.searchsorted(time_us, time_us - SECOND_US, side="right")
    return float((sums[1:] - sums[first]).max())
