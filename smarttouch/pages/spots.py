"""Spots of ink: candidates for letters, their usual height, and letters of two lines that touch."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_FEWEST_PIXELS = 3  # fewest pixels of a spot; a smaller one is a speck in any readable print
_LEAST_SIDE = 3
_MOST_PART = 0.25
"""Part of the page's shorter side above which a spot is a picture, a frame or a dark margin."""
_LETTER = (0.55, 9.0)
"""Range of letter heights on a page, relative to the usual one; dots are lower."""
_COMMA = (0.8, 0.5)  # largest height and width of a comma or a quote, relative to the usual height
_LONGEST = 40.0
"""Largest ratio of length to height of a word with touching letters; longer ones are rules."""
_THICK = 0.5  # width of a vertical rule, in letter heights, above which it is a bar of a picture
_FILLED = 0.15  # least part of its box that a picture fills
_RULE = 12.0  # ratio of length to height above which a spot is a rule
_UNDERLINE, _THIN = 3.0, 0.3
"""Least length and most thickness of a line under a word, in letter heights."""
_BELOW, _HANGING = 0.4, 0.2
"""Height of the zone below it, in the same, and most ink there: that of descenders."""
_STANDING = 0.5
"""Least part of its length that has letters above it; bars of large letters have less."""


@dataclass(frozen=True, eq=False)
class Spots:
    """Connected spots of ink, (N,) px; right and bottom are the first column and row outside."""

    left: NDArray[np.int_]
    top: NDArray[np.int_]
    right: NDArray[np.int_]
    bottom: NDArray[np.int_]
    area: NDArray[np.int_]

    @property
    def height(self) -> NDArray[np.int_]:
        """Height of each spot, (N,) px."""
        return self.bottom - self.top

    @property
    def width(self) -> NDArray[np.int_]:
        """Width of each spot, (N,) px."""
        return self.right - self.left

    @property
    def usual_height(self) -> float:
        """Median height, px, each spot weighted by its size so that dots count for little."""
        order = np.argsort(self.height)
        weight = np.cumsum(np.sqrt(self.area[order]))
        return float(self.height[order][np.searchsorted(weight, weight[-1] / 2)])

    @property
    def transposed(self) -> "Spots":
        """The same spots with columns and rows exchanged."""
        return Spots(self.top, self.left, self.bottom, self.right, self.area)

    def of(self, chosen: NDArray[np.bool_] | NDArray[np.int_]) -> "Spots":
        """Return some of the spots."""
        return Spots(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def find_spots(ink: NDArray[np.bool_]) -> Spots:
    """Return the connected spots of an (H, W) image of ink, specks left out."""
    return _labeled(ink)[0]


def usual_height(spots: Spots, shape: tuple[int, int]) -> float | None:
    """Return the usual height of letters, px; None if no spot may be one."""
    height, width = spots.height, spots.width
    kept = (
        (height >= _LEAST_SIDE)
        & (height < _MOST_PART * min(shape))
        & (width < _RULE * height)
        & (height < _RULE * width)
    )
    if not kept.any():
        return None
    return spots.of(kept).usual_height


def like_letters(spots: Spots, height: float) -> NDArray[np.bool_]:
    """Return for each spot, (N,) bool, whether it may be a letter, or several that touch."""
    smallest, largest = (part * height for part in _LETTER)
    right_size = (spots.height >= smallest) & (spots.height <= largest)
    right_size &= (spots.height > _COMMA[0] * height) | (spots.width > _COMMA[1] * height)
    return np.asarray(right_size & (spots.width < _LONGEST * spots.height))


def find_pictures(ink: NDArray[np.bool_], height: float) -> tuple[Spots, NDArray[np.bool_], Spots]:
    """Return all spots of ink, the ink of pictures, (H, W) bool, and these as spots.

    Pictures are spots large both ways; those that overlap are one.
    """
    spots, label, labels = _labeled(ink)
    large = np.minimum(spots.width, spots.height) > _LETTER[1] * height
    large &= spots.area > _FILLED * spots.width * spots.height
    boxes = spots.of(large)
    apart: list[int] = []
    for k in np.argsort(-boxes.width * boxes.height):
        across = (boxes.left[apart] < boxes.right[k]) & (boxes.right[apart] > boxes.left[k])
        down = (boxes.top[apart] < boxes.bottom[k]) & (boxes.bottom[apart] > boxes.top[k])
        if not (across & down).any():
            apart.append(int(k))
    return spots, np.isin(labels, label[large]), boxes.of(np.array(apart, np.int_))


_FRAME, _HOLLOW, _DRAWN = (6.0, 2.5), 0.3, 0.85
"""Least width and height of a frame around text, in letter heights, most part of its box that its
ink fills, and least part of each side that is drawn."""


def find_frames(ink: NDArray[np.bool_], spots: Spots, height: float) -> NDArray[np.float64]:
    """Return the boxes that are drawn around text, (N, 4) px: left, top, right, bottom."""
    large = (spots.width > _FRAME[0] * height) & (spots.height > _FRAME[1] * height)
    large &= spots.area < _HOLLOW * spots.width * spots.height
    found = []
    edge = max(2, round(_THIN * height))
    for k in np.flatnonzero(large):
        box = ink[spots.top[k] : spots.bottom[k], spots.left[k] : spots.right[k]]
        sides = (box[:edge], box[-edge:], box[:, :edge].T, box[:, -edge:].T)
        if min(side.any(axis=0).mean() for side in sides) > _DRAWN:
            found.append((spots.left[k], spots.top[k], spots.right[k], spots.bottom[k]))
    return np.array(found, np.float64).reshape(-1, 4)


def letters_alone(ink: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Spots, float] | None:
    """Return the ink of letter candidates, the candidates, and their usual height, px."""
    spots, label, labels = _labeled(ink)
    height = usual_height(spots, ink.shape)
    if height is None:
        return None
    kept = like_letters(spots, height)
    is_letter = np.zeros(int(labels.max()) + 1, np.bool_)
    is_letter[label[kept]] = True
    return is_letter[labels], spots.of(kept), height


def widest_white(
    spots: Spots, left: float, right: float, top: float, bottom: float
) -> tuple[float, float]:
    """Return the ends of the widest part without ink, px, of a gap from ``left`` to ``right``."""
    inside = (spots.right > left) & (spots.left < right)
    inside &= (spots.bottom > top) & (spots.top < bottom)
    starts = np.concatenate([[left], np.sort(spots.right[inside])])
    ends = np.concatenate([np.sort(spots.left[inside]), [right]])
    widest = int((ends - starts).argmax())
    return float(starts[widest]), float(ends[widest])


def _labeled(ink: NDArray[np.bool_]) -> tuple[Spots, NDArray[np.int_], NDArray[np.int32]]:
    """Return spots, the label of each, and the image of labels."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(ink.view(np.uint8), connectivity=8)
    label = np.flatnonzero(boxes[:, 4] >= _FEWEST_PIXELS)[1:]
    left, top, width, height, area = boxes[label].astype(np.int_).T
    spots = Spots(left, top, left + width, top + height, area)
    return spots, label, np.asarray(labels, np.int32)


def find_dividers(ink: NDArray[np.bool_], height: float) -> NDArray[np.bool_]:
    """Return the ink of vertical rules, (H, W) bool: between columns, of frames and tables."""
    # A slightly tilted rule steps sideways by a pixel.
    wide = cv2.dilate(ink.view(np.uint8), np.ones((1, 3), np.uint8))
    upright = cv2.morphologyEx(wide, cv2.MORPH_OPEN, np.ones((round(_RULE * height), 1), np.uint8))
    side = max(4, round(_THICK * height) + 2)
    thick = cv2.morphologyEx(upright, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    return np.asarray((upright > cv2.dilate(thick, np.ones((3, 3), np.uint8))) & ink, np.bool_)


def find_rules(ink: NDArray[np.bool_], height: float) -> NDArray[np.bool_]:
    """Return the ink of horizontal rules, (H, W) bool: underlines, ruled paper, frames."""
    page = ink.view(np.uint8)
    rules = cv2.morphologyEx(page, cv2.MORPH_OPEN, np.ones((1, round(_RULE * height)), np.uint8))
    run = np.ones((1, round(_UNDERLINE * height)), np.uint8)
    short = cv2.subtract(cv2.morphologyEx(page, cv2.MORPH_OPEN, run), rules)
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(short, connectivity=8)
    thick, deep = max(3, round(_THIN * height)), max(2, round(_BELOW * height))
    for label in np.flatnonzero(boxes[:, 3] <= thick):
        left, top, width, high, _ = boxes[label].tolist()
        columns = slice(left, left + width)
        above = ink[max(0, top - round(height)) : max(0, top - 1), columns].any(axis=0)
        # Letters hang from the line above them in some scripts.
        below = ink[top + high + 1 : top + high + 1 + deep, columns]
        if below.size and below.mean() < _HANGING and above.mean() > _STANDING:
            rules[top : top + high, columns][labels[top : top + high, columns] == label] = 1
    # A slightly tilted or frayed rule steps up and down by a pixel.
    return np.asarray(cv2.dilate(rules, np.ones((3, 1), np.uint8)), np.uint8).view(np.bool_)


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
