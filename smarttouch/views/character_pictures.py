"""Images and electrode arrays drawn with characters."""

from itertools import groupby

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Profile

Row = list[tuple[str, str]]
"""One row of the terminal: pieces of text, each with its style."""
MOST_ROWS, MOST_COLUMNS = 16, 64  # largest picture, in characters: drawing more could delay the run

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_SHADE = 15  # step between shades of gray; divides 255, so white stays white
_DITHER = (np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) + 0.5) * 16
"""Gray thresholds of the dots in two adjacent Braille characters (ordered dithering)."""


def image_rows(image: NDArray[np.uint8], columns: int, rows: int, *, color: bool) -> list[Row]:
    """Draw a gray image with at most ``columns`` by ``rows`` characters. With ``color``, each
    character is a half block with two pixels; otherwise, it is a Braille character."""
    height, width = image.shape
    rows, columns = min(rows, MOST_ROWS), min(columns, MOST_COLUMNS)
    wide = max(2, round(2 * rows * width / height))
    if wide > columns:
        rows, wide = max(1, round(columns * height / width / 2)), columns
    if not color:
        return _dots(image, wide, rows)
    small = cv2.resize(image, (wide, 2 * rows), interpolation=cv2.INTER_AREA)
    # Fewer shades give longer runs of one color, which draw faster.
    small = small // _SHADE * _SHADE
    drawn: list[Row] = []
    for upper, lower in zip(small[::2], small[1::2], strict=True):
        drawn.append([])
        for pair, run in groupby(zip(upper.tolist(), lower.tolist(), strict=True)):
            above, below = (f"rgb({grey},{grey},{grey})" for grey in pair)
            drawn[-1].append(("▀" * len(list(run)), f"{above} on {below}"))
    return drawn


def _dots(image: NDArray[np.uint8], columns: int, rows: int) -> list[Row]:
    small = cv2.resize(image, (2 * columns, 4 * rows), interpolation=cv2.INTER_AREA)
    bright = small > np.tile(_DITHER, (rows, -(-columns // 2)))[:, : 2 * columns]
    signs = np.einsum("rickd,id->rc", bright.reshape(rows, 4, columns, 1, 2), _DOTS)
    return [[("".join(chr(0x2800 + pattern) for pattern in row), "")] for row in signs.tolist()]


class ArrayPicture:
    """Picture of an electrode array, drawn with characters."""

    def __init__(self, profile: Profile) -> None:
        position = profile.electrodes.position_mm
        step_x, step_y = _finest(position[:, 0]), _finest(position[:, 1])
        self._column = np.rint((position[:, 0] - position[:, 0].min()) / step_x).astype(int)
        self._row = np.rint((position[:, 1] - position[:, 1].min()) / step_y).astype(int)
        self._columns, self._rows = int(self._column.max()) + 1, int(self._row.max()) + 1
        self._spread = 3 if step_x >= step_y else 2

    def merged(self, columns: int, rows: int) -> int:
        """Return how many electrodes each character combines along each axis."""
        return max(-(-self._columns // columns), -(-self._rows // rows))

    def draw(self, parts: NDArray[np.float32], columns: int, rows: int) -> list[Row]:
        """Draw currents, (E,) relative to full current, with at most ``columns`` by ``rows``
        characters. Each character shows the largest current of its electrodes."""
        merged = self.merged(columns, rows)
        shape = -(-self._rows // merged), -(-self._columns // merged)
        strongest = np.full(shape, -1.0)
        np.maximum.at(strongest, (self._row // merged, self._column // merged), parts.clip(0, 1))
        spread = min(self._spread, columns // shape[1])
        drawn: list[Row] = []
        for line in strongest.tolist():
            drawn.append([])
            for part, run in groupby(line):
                sign, style = _sign(part, spread)
                drawn[-1].append((sign * len(list(run)), style))
        return drawn


def _sign(part: float, spread: int) -> tuple[str, str]:
    """Return text and style for a current from 0 to 1; a negative value means no electrode."""
    if part <= 0:
        return ("·" if part == 0 else " ").ljust(spread), "grey42"
    glow = round(90 + 165 * part)
    mark = "○◔◑◕●"[min(4, int(part * 5))]
    return mark.ljust(spread), f"rgb({glow},{round(glow * 0.75)},40)"


def _finest(values: NDArray[np.float64]) -> float:
    steps = np.diff(np.unique(values.round(6)))
    return float(steps.min()) if steps.size else 1.0
