"""What lies under the hand: the contract of textures, and opening one."""

import re
from abc import ABC, abstractmethod
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import PageError

FINEST_PITCH_MM = 0.1
COARSEST_PITCH_MM = 200.0
_NUMBER = r"([0-9]*\.?[0-9]+)"


class Passed(NamedTuple):
    """What has passed under the electrodes since they were looked at before."""

    height: NDArray[np.float32]
    """Of the last ridge that passed each, (E,) in [0, 1]; 0 where none did."""
    merged: int
    """Ridges that passed together with another one of the same electrode."""


class Feeler(Protocol):
    """Electrodes over a texture, which remember where they were."""

    def place(self, x_mm: float, y_mm: float) -> None:
        """Put the middle of the array somewhere: nothing has passed on the way."""

    def move(self, x_mm: float, y_mm: float) -> Passed:
        """Move the middle of the array there in a straight line."""


class Texture(ABC):
    """A surface with ridges that stays where it is.

    Attributes
    ----------
    title : str
    size_mm : tuple of float, mm, or None
        Width and height; None where it has no ends.
    middle_mm : tuple of float, mm
        Of it, or of a tile of it.
    notes : list of str
        What was taken for granted, a sentence each.
    """

    def __init__(
        self,
        title: str,
        size_mm: tuple[float, float] | None,
        middle_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.title = title
        self.size_mm = size_mm
        self.middle_mm = middle_mm
        self.notes: list[str] = []

    @abstractmethod
    def feeler(self, position_mm: NDArray[np.float64]) -> Feeler:
        """Return electrodes over it.

        Parameters
        ----------
        position_mm : ndarray, (E, 2), mm
            Of the electrodes, from the middle of the array.
        """

    @abstractmethod
    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of it as ink on paper, (H, W) uint8: dark is high."""


def open_texture(
    spec: str,
    *,
    dpi: float | None = None,
    width_mm: float | None = None,
    grain_mm: float | None = None,
    tiled: bool = False,
    light_on_dark: bool = False,
) -> Texture:
    """Open a texture.

    Parameters
    ----------
    spec : str
        ``grating:4mm``, ``grating:4mm,30deg``, ``text:STRING``, or a file: an image (ink is
        high), or a height map (16 bits or floating point, or .npy: bright is high).
    dpi, width_mm : float, optional
        Scale of a file that does not say; width of a text.
    grain_mm : float, optional, mm
        Way between two pulses on what is high and wide; measured if not given.
    tiled : bool
        Repeat it without end.
    light_on_dark : bool
        What is bright is high.

    Raises
    ------
    PageError
        If there is no such texture, or an option is not for it.
    """
    kind, _, rest = spec.partition(":")
    if kind == "grating" and ":" in spec:
        given = {
            "--dpi": dpi, "--width-mm": width_mm, "--grain-mm": grain_mm, "--tiled": tiled,
            "--light-on-dark": light_on_dark,
        }  # fmt: skip
        for name, value in given.items():
            if value:
                raise PageError(f"{name} is for images, and {spec} is exact: leave it out")
        return _grating(spec, rest)
    from smarttouch.mouse.relief import Relief
    from smarttouch.mouse.relief_file import load_heights, print_heights

    if kind == "text" and ":" in spec:
        if dpi is not None:
            raise PageError("--dpi is for images, and a text is printed anew: give --width-mm")
        heights = print_heights(rest, width_mm)
    else:
        heights = load_heights(Path(spec), dpi, width_mm)
    return Relief(heights, grain_mm, tiled, light_on_dark)


def _grating(spec: str, rest: str) -> Texture:
    from smarttouch.mouse.grating import Grating

    match = re.fullmatch(rf"\s*{_NUMBER}\s*(mm)?\s*(,\s*([-+]?){_NUMBER}\s*(deg|°)?)?\s*", rest)
    if match is None:
        raise PageError(f"{spec!r} is no grating: write grating:4mm or grating:4mm,30deg")
    pitch_mm, sign, angle = float(match[1]), match[4], float(match[5] or 0)
    return Grating(pitch_mm, -angle if sign == "-" else angle)
