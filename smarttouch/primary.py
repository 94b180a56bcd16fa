"""The tactile primary colors: the afferent classes a display mixes."""

from enum import IntEnum


class Primary(IntEnum):
    """One tactile primary color (Kajimoto et al., Section I and Fig. 2).

    The value is the row of that primary in every ``(3, E)`` array.
    """

    RA = 0
    """Meissner corpuscle: vibration, best at 30 Hz."""
    SAI = 1
    """Merkel cell: static pressure."""
    PC = 2
    """Pacinian corpuscle: vibration, best at 250 Hz."""
