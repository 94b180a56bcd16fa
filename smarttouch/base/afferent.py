"""Afferent classes, and the modes of a run. A mode stimulates one class or several."""

from enum import IntEnum, StrEnum


class Afferent(IntEnum):
    """Afferent class, a tactile primary color (Kajimoto et al., Section I and Fig. 2).

    The value is the row of the class in ``(3, E)`` arrays.
    """

    RA = 0
    """Meissner corpuscle: vibration, best at 30 Hz."""
    SAI = 1
    """Merkel cell: static pressure."""
    PC = 2
    """Pacinian corpuscle: vibration, best at 250 Hz."""


CLASS_COLORS = {Afferent.RA: "#d55e00", Afferent.SAI: "#0072b2", Afferent.PC: "#009e73"}
"""Color of each class in pictures, from Okabe and Ito's palette for color-blind readers (2008)."""


class Mode(StrEnum):
    """Mode of a run: which afferent classes it stimulates, and by which input."""

    RA = "RA"
    """Ink in the image stimulates RA."""
    SAI = "SAI"
    """Ink in the image stimulates SAI."""
    PC = "PC"
    """Ink in the image stimulates PC, and inevitably also the shallower classes RA and SAI."""
    NATURAL = "natural"
    """Moving edges stimulate RA, and constant ink stimulates SAI."""
    COLOR = "color"
    """The source gives an activation for each class. This is for sources without images."""

    @property
    def afferents(self) -> tuple[Afferent, ...]:
        if self is Mode.COLOR:
            return tuple(Afferent)
        return (Afferent.RA, Afferent.SAI) if self is Mode.NATURAL else (Afferent[self.name],)
