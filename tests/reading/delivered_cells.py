"""Cells from a picture of what was delivered."""

import numpy as np

from smarttouch.braille.cells import dots_to_cells


def decode(picture, layout, count):
    """Return the delivered cells of a line of so many."""
    dots = 8 if layout.eight else 6
    rows, columns = layout.dots_of(dots_to_cells(np.ones((count, dots), bool)))
    across, down = layout.pitch_mm
    on = picture.at((columns + 0.5) * across, (rows + 0.5) * down) > 0.5
    return dots_to_cells(on.reshape(count, dots))
