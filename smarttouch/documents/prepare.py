"""Preparation of a page for reading: straight, black on white, its lines in order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.page_image import Page
from smarttouch.documents.straighten import straighten
from smarttouch.documents.strips import cut_strip
from smarttouch.documents.text_lines import TextLine, ink_of_lines, lines_of

LEFT_OUT = "left out: "
"""Beginning of the note of what is not among the lines."""


@dataclass(frozen=True, eq=False)
class PreparedPage:
    """A page ready to be read.

    Attributes
    ----------
    page : Page
        The page, straightened.
    cleaned : ndarray, (H, W) uint8
        The same as dark on light, its paper exactly 255.
    lines : tuple of TextLine
        Its lines in reading order; empty if there is no text.
    light_on_dark : bool
        Whether it is printed light on dark.
    notes : tuple of str
        Corrections that were made, for the user.
    """

    page: Page
    cleaned: NDArray[np.uint8]
    lines: tuple[TextLine, ...]
    light_on_dark: bool
    notes: tuple[str, ...]

    def strip(self, index: int, height_px: int) -> NDArray[np.uint8]:
        """Return a line straightened, (height_px, W), ascenders to descenders filling it."""
        return cut_strip(self.cleaned, self.page.mm_per_pixel, self.lines[index], height_px)


def prepare_page(
    page: Page,
    light_on_dark: bool | None = None,
    straightened: bool = True,
    quarter: bool = True,
) -> PreparedPage:
    """Prepare a page for reading.

    Parameters
    ----------
    page : Page
        A scan, a photograph or a picture of print.
    light_on_dark : bool, optional
        Whether it is printed light on dark; found out if not given.
    straightened : bool
        Lay sheets flat and turn text level first.
    quarter : bool
        Also turn text that runs up or down the page.
    """
    notes: list[str] = []
    if straightened:
        page, notes = straighten(page, quarter)
    page, paper = ink_of_lines(page, light_on_dark)
    lines, left_out = lines_of(paper, page.mm_per_pixel)
    if left_out:
        notes.append(f"{LEFT_OUT}{left_out}")
    return PreparedPage(page, paper.cleaned, tuple(lines), paper.light_on_dark, tuple(notes))
