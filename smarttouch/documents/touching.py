"""Separation of letters of one line that touch those of the next."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.letters import Spots, like_letters

_TWO_LINES = 1.7  # usual heights of a spot that may span two lines of text
_MOST_LINES = 12.0
_LEAST_LINE = 0.6  # least height of a line, relative to the usual height
_VALLEY = 0.35  # ink between two lines of words that touch, relative to that in either
_TWO_LETTERS = 4.0  # largest height, in usual ones, of two letters that touch, one below the other
_BESIDE = 1.5  # largest distance of letters beside them, in usual heights


def part_lines(ink: NDArray[np.bool_], spots: Spots, height: float) -> NDArray[np.bool_]:
    """Return the ink, (H, W) bool, cut where letters of one line touch those of the next."""
    tall = (spots.height > _TWO_LINES * height) & (spots.height < _MOST_LINES * height)
    words = tall & (spots.width > spots.height)
    letters = tall & ~words & (spots.height < _TWO_LETTERS * height)
    parted = ink.copy() if tall.any() else ink
    for index in np.flatnonzero(words):
        _part_words(parted, spots, int(index), height)
    usual = spots.of(like_letters(spots, height) & ~tall)
    for index in np.flatnonzero(letters):
        _part_letters(parted, spots, int(index), usual, height)
    return parted


def _part_words(ink: NDArray[np.bool_], spots: Spots, index: int, height: float) -> None:
    """Cut a long spot where it has much less ink than in the lines above and below."""
    columns = slice(spots.left[index], spots.right[index])
    least = round(_LEAST_LINE * height)
    parts = [(int(spots.top[index]), int(spots.bottom[index]))]
    while parts:
        top, bottom = parts.pop()
        if bottom - top <= _TWO_LINES * height:
            continue
        profile = ink[top:bottom, columns].sum(axis=1)
        cut = least + int(profile[least:-least].argmin())
        if profile[cut] < _VALLEY * min(profile[:cut].max(), profile[cut:].max()):
            ink[top + cut, columns] = False
            parts += [(top, top + cut), (top + cut + 1, bottom)]


def _part_letters(
    ink: NDArray[np.bool_], spots: Spots, index: int, usual: Spots, height: float
) -> None:
    """Cut a narrow spot between the lines beside it, if there are two.

    A large letter has large letters beside it, or a line on one side only.
    """
    left, right = int(spots.left[index]), int(spots.right[index])
    top, bottom = int(spots.top[index]), int(spots.bottom[index])
    middle = (usual.top + usual.bottom) / 2
    near = (usual.right > left - _BESIDE * height) & (usual.left < right + _BESIDE * height)
    near &= (middle > top) & (middle < bottom)
    upper, lower = near & (middle < (top + bottom) / 2), near & (middle > (top + bottom) / 2)
    on_both_sides = (usual.right[near] <= left).any() and (usual.left[near] >= right).any()
    if not (upper.any() and lower.any() and on_both_sides):
        return
    first, last = int(usual.bottom[upper].min()), int(usual.top[lower].max())
    if first < last:
        row = first + int(ink[first:last, left:right].sum(axis=1).argmin())
        ink[row, left:right] = False
