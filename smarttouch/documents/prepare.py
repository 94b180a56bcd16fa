"""Preparation of a page for reading: straight, black on white, its lines in order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.page_image import Page
from smarttouch.documents.straighten import straighten
from smarttouch.documents.strips import cut_strip
from smarttouch.documents.text_lines import TextLine, ink_of_lines, lines_in_ink

LEFT_OUT = "left out: "
"""Beginning of the note on what is not among the lines."""


@dataclass(frozen=True, eq=False)
class PreparedPage:
    """Page straightened and cleaned to dark on white, its paper 255, with lines in reading
    order.
    """

    page: Page
    cleaned: NDArray[np.uint8]
    lines: tuple[TextLine, ...]
    light_on_dark: bool
    notes: tuple[str, ...]

    def strip(self, index: int, height_px: int) -> NDArray[np.uint8]:
        """Return a line straightened, (height_px, W) uint8, ascenders to descenders filling it."""
        return cut_strip(self.cleaned, self.page.mm_per_pixel, self.lines[index], height_px)


def prepare_page(
    page: Page,
    light_on_dark: bool | None = None,
    straightened: bool = True,
    quarter: bool = True,
) -> PreparedPage:
    """Prepare a scan, photograph or picture of print for reading, detecting its polarity if not
    given.

    ``quarter`` allows a turn by 90° where the text runs up or down the page.
    """
    notes: list[str] = []
    if straightened:
        page, notes = straighten(page, quarter)
    page, paper = ink_of_lines(page, light_on_dark)
    lines, left_out = lines_in_ink(paper, page.mm_per_pixel)
    if left_out:
        notes.append(f"{LEFT_OUT}{left_out}")
    return PreparedPage(page, paper.cleaned, tuple(lines), paper.light_on_dark, tuple(notes))
