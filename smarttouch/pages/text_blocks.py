"""Blocks of text on a page, by Tesseract's layout analysis, and the lines in them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.tesseract_layout import analyze_layout

_LETTER_PX, _LARGEST = 20.0, 2.0  # height of letters for the analysis, and most enlargement
_CLEARLY, _MOSTLY = 0.7, 0.9  # least part of a line in one block, and of such lines of a page


def blocks_of_lines(
    cleaned: NDArray[np.uint8], height: float, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.int_] | None:
    """Return the number of the block of each line, (N,), 0 where it is not clear.

    ``cleaned`` is the page, (H, W); ``height`` that of its letters; ``x`` and ``y`` are places in
    the middle of each line, (N, P) px. Returns None where Tesseract is not installed, or the lines
    do not fit its blocks.
    """
    scale = min(_LETTER_PX / height, _LARGEST)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    grey = cv2.resize(cleaned, None, fx=scale, fy=scale, interpolation=how)
    blocks = analyze_layout(np.asarray(grey, np.uint8))
    if blocks is None:
        return None
    numbers = np.zeros(grey.shape, np.int_)
    for number, left, top, right, bottom in blocks:
        numbers[top:bottom, left:right] = number
    rows, columns = (
        np.clip(np.round(scale * each).astype(int), 0, size - 1)
        for each, size in ((y, len(numbers)), (x, len(numbers[0])))
    )
    there = numbers[rows, columns]
    middle = np.median(there, axis=1).astype(int)
    clear = ((there == middle[:, None]).mean(axis=1) >= _CLEARLY) & (middle > 0)
    return np.where(clear, middle, 0) if clear.mean() >= _MOSTLY else None
