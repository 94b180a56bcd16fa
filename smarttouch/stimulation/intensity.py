"""Intensity: gated by finger force, and never rising suddenly."""

import math

from smarttouch.profile import ForceLaw


def force_gate(force_n: float, law: ForceLaw) -> float:
    """Return the intensity at a finger force, in [0, 1].

    Zero below contact, one from full force on, rising linearly or with the
    logarithm of force in between (paper, Section IV-B). A force that is not a
    number is no contact.
    """
    if not force_n > law.contact_n:
        return 0.0
    if force_n >= law.full_n:
        return 1.0
    if law.law == "linear":
        return (force_n - law.contact_n) / (law.full_n - law.contact_n)
    return math.log(force_n / law.contact_n) / math.log(law.full_n / law.contact_n)


class SoftStart:
    """Rate limiter by which intensity rises no faster than the ramp, and falls at once.

    Parameters
    ----------
    ramp_s : float, s
        Shortest time from zero to full.
    """

    def __init__(self, ramp_s: float) -> None:
        self._ramp_s = ramp_s
        self._intensity = 0.0
        self._time_ns: int | None = None

    def follow(self, wanted: float, time_ns: int) -> float:
        """Return the intensity allowed at ``time_ns``; the first is always zero.

        Where time goes back, as in an edited file, intensity does not rise.
        """
        elapsed_s = 0.0 if self._time_ns is None else max(0.0, (time_ns - self._time_ns) / 1e9)
        self._time_ns = time_ns
        self._intensity = min(wanted, self._intensity + elapsed_s / self._ramp_s)
        return self._intensity

    def restart(self) -> None:
        """Restart: the next intensity is zero."""
        self._intensity = 0.0
        self._time_ns = None
