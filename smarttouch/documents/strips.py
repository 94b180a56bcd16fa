"""Lines of text cut out of a page and straightened."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.text_lines import TextLine

_AROUND = 0.8  # extent of the page considered above and below a line, in heights of the line
SIDES = 0.25
"""Paper kept before and after a line, in heights of the line."""
_INK = 128  # level below which is ink, when the spots of neighboring lines are located
_FADED = 2  # samples by which the grey edge of a spot reaches beyond its ink


def cut_strip(
    cleaned: NDArray[np.uint8], mm_per_pixel: float, line: TextLine, height_px: int
) -> NDArray[np.uint8]:
    """Return a line cut out of a page and straightened along its baseline, (height_px, W) uint8.

    Its print, from ascenders to descenders, fills the height; `SIDES` of paper stay at each end.
    What reaches in from the lines above and below is left out.
    """
    line_px = line.height_mm / mm_per_pixel
    # A smaller strip is sampled as finely as the page, then averaged.
    steps = max(1, math.ceil(line_px / height_px))
    rows = steps * height_px
    scale_mm = line.height_mm / rows
    along_mm = _places(line, scale_mm * steps, steps)
    above = round(_AROUND * rows)
    across_mm = (np.arange(-above, rows + above) + 0.5) * scale_mm - line.ascent_mm
    # Columns are not tilted: strokes stay upright on a curved page.
    x_mm = np.broadcast_to(along_mm, (len(across_mm), len(along_mm)))
    y_mm = line.baseline_mm(along_mm) + across_mm[:, None]
    wide = cv2.remap(
        cleaned,
        np.asarray(x_mm / mm_per_pixel - 0.5, np.float32),
        np.asarray(y_mm / mm_per_pixel - 0.5, np.float32),
        cv2.INTER_CUBIC if rows > line_px else cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=255,
    )
    own = _without_neighbors(np.asarray(wide, np.uint8), above, rows)
    size = (len(along_mm) // steps, height_px)
    return np.asarray(cv2.resize(own, size, interpolation=cv2.INTER_AREA), np.uint8)


def _places(line: TextLine, pixel_mm: float, steps: int) -> NDArray[np.float64]:
    """Return the x of every column, at equal distances along the baseline, mm."""
    sides_mm = SIDES * line.height_mm
    x_mm = np.linspace(line.left_mm - sides_mm, line.right_mm + sides_mm, 400)
    passed_mm = np.cumsum(np.hypot(np.diff(x_mm), np.diff(line.baseline_mm(x_mm))))
    passed_mm = np.concatenate([[0.0], passed_mm])
    columns = max(1, round(float(passed_mm[-1]) / pixel_mm)) * steps
    wanted_mm = (np.arange(columns) + 0.5) * float(passed_mm[-1]) / columns
    return np.interp(wanted_mm, passed_mm, x_mm)


def _without_neighbors(wide: NDArray[np.uint8], above: int, rows: int) -> NDArray[np.uint8]:
    """Return the middle rows of a wider cut, without spots that lie mostly beyond them."""
    ink = (wide < _INK).view(np.uint8)
    own = slice(above, above + rows)
    count, labels = cv2.connectedComponents(ink, connectivity=8)
    whole = np.bincount(labels.ravel(), minlength=count)
    inside = np.bincount(labels[own].ravel(), minlength=count)
    foreign = (2 * inside < whole) & (inside > 0)
    foreign[0] = False
    strip = wide[own]
    if not foreign.any():
        return strip
    side = 2 * _FADED + 1
    spots = foreign.astype(np.uint8)[labels[own]]
    faded = cv2.dilate(spots, np.ones((side, side), np.uint8)) > 0
    # Ink of this line nearby is kept.
    faded &= (labels[own] == 0) | (spots > 0)
    return np.where(faded, np.uint8(255), strip)
