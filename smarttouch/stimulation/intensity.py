"""Intensity by finger force."""

import math

from smarttouch.profile import ForceLaw


def force_gate(force_n: float, law: ForceLaw) -> float:
    """Return the intensity at a finger force, in [0, 1].

    Zero below contact, one from full force on, rising linearly or with the logarithm of force in
    between (paper, Section IV-B). A force of NaN is no contact.
    """
    if not force_n > law.contact_n:
        return 0.0
    if force_n >= law.full_n:
        return 1.0
    if law.law == "linear":
        return (force_n - law.contact_n) / (law.full_n - law.contact_n)
    return math.log(force_n / law.contact_n) / math.log(law.full_n / law.contact_n)
