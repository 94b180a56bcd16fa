"""Classes of afferents, the tactile primary colors that a display mixes."""

from enum import IntEnum, StrEnum


class Afferent(IntEnum):
    """Class of afferents, a tactile primary color (Kajimoto et al., Section I and Fig. 2).

    The value is the row of that class in every ``(3, E)`` array.
    """

    RA = 0
    """Meissner corpuscle: vibration, best at 30 Hz."""
    SAI = 1
    """Merkel cell: static pressure."""
    PC = 2
    """Pacinian corpuscle: vibration, best at 250 Hz."""


CLASS_COLORS = {Afferent.RA: "#d55e00", Afferent.SAI: "#0072b2", Afferent.PC: "#009e73"}
"""Color of each class in pictures, of Okabe and Ito's set for color-blind readers (2008)."""


class Mode(StrEnum):
    """Modes: the afferent classes that are driven, and by what."""

    RA = "RA"
    """Ink drives RA alone."""
    SAI = "SAI"
    """Ink drives SAI alone."""
    PC = "PC"
    """Ink drives PC, and with it what lies above: PC cannot be reached alone."""
    NATURAL = "natural"
    """Moving edges of the ink drive RA, what stays drives SAI."""
    COLOR = "color"
    """Each class as stimuli have it: for sources that give these and no images."""

    @property
    def afferents(self) -> tuple[Afferent, ...]:
        if self is Mode.COLOR:
            return tuple(Afferent)
        return (Afferent.RA, Afferent.SAI) if self is Mode.NATURAL else (Afferent[self.name],)
