"""Pulse rates of each afferent class, and their dependence on force."""

from collections.abc import Mapping

from smarttouch.afferent import Afferent

SLOWEST = 0.2
"""Part of the full rate at the lightest touch of something hard: 10 of 50 Hz, the slowest pulses of
the paper's experiments (Section III-B.2)."""
_ON_TIME = 0.25
"""Part of its interval: a class that is later than this starts a new grid."""


def rate_share(pressure: float, softness: float) -> float:
    """Return the share of the full pulse rate at a finger pressure.

    SAI afferents encode pressure in their firing rate. Pressed on something
    hard they fire faster; on something soft the rate hardly changes (paper,
    Section III-B.2, where a constant rate under a moving finger felt soft).

    Parameters
    ----------
    pressure : float, in [0, 1]
        Intensity by the finger's force, see `force_gate`.
    softness : float, in [0, 1]
        1 leaves the rate as it is, 0 lets it follow force.
    """
    return softness + (1 - softness) * max(SLOWEST, pressure)


class PulseRates:
    """Separate time grids of several classes.

    Parameters
    ----------
    rates_hz : mapping of Afferent to float, Hz
        Full rate of each.
    merge_us : int, µs
        Classes that are due closer together than this pulse in one sequence:
        the shortest period of a sequence.
    """

    def __init__(self, rates_hz: Mapping[Afferent, float], merge_us: int) -> None:
        self._rates_hz = dict(rates_hz)
        self._merge_us = merge_us
        self._last_ns: dict[Afferent, float] = {}

    def due(
        self, time_ns: int, shares: Mapping[Afferent, float]
    ) -> tuple[tuple[Afferent, ...], int]:
        """Return the classes that pulse now, and the time until the next is due, µs.

        Parameters
        ----------
        time_ns : int
            Now.
        shares : mapping of Afferent to float
            Of each full rate, see `rate_share`.
        """
        now, merge_ns = [], 1000 * self._merge_us
        next_ns = []
        for afferent, rate_hz in self._rates_hz.items():
            interval_ns = 1e9 / (rate_hz * shares[afferent])
            due_ns = self._last_ns.get(afferent, -float("inf")) + interval_ns
            if due_ns - time_ns < merge_ns:
                now.append(afferent)
                if time_ns - due_ns > _ON_TIME * interval_ns:
                    due_ns = time_ns
                self._last_ns[afferent] = due_ns
                due_ns += interval_ns
            next_ns.append(due_ns)
        return tuple(now), max(self._merge_us, round((min(next_ns) - time_ns) / 1000))

    def restart(self) -> None:
        """Restart: all classes are due."""
        self._last_ns.clear()
