"""Separation of ink from paper, under any light, and of light print in dark panels."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.spots import Spots, find_spots, usual_height

Grey = NDArray[np.uint8]

_REDUCTION, _REDUCED_PIXELS = 4, 20_000
"""Reduction at which paper is estimated, less on small pages: light changes slowly."""
_WINDOW_PX, _LEAST_WINDOWS = 51, 12
"""Window of paper, wider than any stroke of text, and the least number of them across a page."""
_WIDER = 5  # factor to a second window, wider than any stroke of a headline
_SOLID = 0.4  # part of the level of paper farther away below which a dark area is ink, not shadow
_STEP = 0.6  # part of the level of neighboring paper below which paper ends
_LEAST_LIGHT = 0.25
"""Part of the brightest paper's level below which an area is the table, not paper."""
_DARKEST = 40.0  # grey level below which an area is too dark to contain ink
_PAPER = 210  # level of paper in the divided image, with room above it for noise
_LEAST_CONTRAST = 0.12  # least contrast of ink against the paper around it
_LEAST_GRAINS = 3.5  # least contrast of ink, in standard deviations of the paper's grain
_GRAINS = 6.7
"""Contrast at which ink begins, in the same; limited to the following parts of Otsu's threshold."""
_LEAST_PART, _MOST_PART = 0.7, 1.1
_EVEN_INK = 0.35
"""Contrast of Otsu's threshold, relative to paper, below which ink is uneven and begins earlier."""
_PEN_PX, _PALE, _SOFT_PX, _STROKES, _NEAREST_GRAINS = (3.5, 5.5), 0.26, 1.0, (0.95, 1.15), 2.0
"""Strokes of this width, with less contrast at the threshold, relative to paper, and with wider
edges are a pen's: their ink begins nearer to the paper, as long as the number of strokes, which
appear or merge, stays within this factor, and at least so many grains from it."""
_AROUND, _CALM, _GRAINY, _STAINED = (3, 3), 5.0, 9.0, -0.5
"""Window, in blocks of 16 pixels, in which a threshold follows the darkness of its own ink; the
grain up to which it does so in full, and from which not at all. On paper with more grain pale ink
is a stain, and the threshold moves away from it, by this power."""
_LOCAL = (0.7, 1.4)  # range of its distance from the paper, relative to the page's
_THROUGH = 0.6
"""Least peak contrast of a spot, relative to the usual ink; fainter ones show through."""
_POOL = 4  # side, in pixels, of the blocks in which spots that show through are detected
_DARKER_QUARTER = 0.25
_DIRECTION_PIXELS = 6_000  # size of the image in which light and dark are compared
_WINDOWS = 16  # windows across a page in which ink is tested to be darker or lighter than paper
_LEAST_SKEW = 0.8
"""Skewness above which print is light on dark: print has 1.5 and more, photographs have less."""
_FEWEST = 4  # fewest dark pixels, in a quarter of the image, that are not there by chance
_LEVEL = np.arange(256)
_QUARTILES = 1.349  # between the quartiles of a normal distribution, in standard deviations
_BRIGHT = 0.7  # part of the paper's level above which pixels are mostly paper


@dataclass(frozen=True, eq=False)
class Paper:
    """Page as dark on light, with the mask of its ink."""

    ink: NDArray[np.bool_]  # (H, W); empty on blank paper
    light_on_dark: bool  # as printed; inverted here
    clean: Callable[[], Grey]
    panels: tuple[list[int], ...] = ()
    """Panels of the other polarity that were turned as well: left, top, right, bottom, px."""

    @functools.cached_property
    def cleaned(self) -> Grey:
        """Page, (H, W): paper exactly 255, ink near 0; made when it is asked for."""
        return self.clean()

    @functools.cached_property
    def spots(self) -> Spots:
        """Connected spots of its ink."""
        return find_spots(self.ink)

    @functools.cached_property
    def letter_height(self) -> float | None:
        """Usual height of its letters, px; None if no spot may be one."""
        return usual_height(self.spots, self.ink.shape)

    def halved(self) -> "Paper":
        """Return it at half the size; a line as thin as a pixel stays ink."""
        part = _halved(self.ink.view(np.uint8) * np.uint8(255))
        return Paper(part >= _HALF, self.light_on_dark, lambda: _halved(self.cleaned))


def separate_ink(grey: Grey, light_on_dark: bool | None = None) -> Paper:
    """Separate ink from paper in an image, (H, W) uint8, detecting its polarity if not given.

    The page is divided by its paper, as it would look without ink. The threshold is Otsu's, moved
    towards the paper where that is even or strokes are a pen's, and away from it where it has
    grain; on calm paper it follows the darkness of the ink around. Spots that stay faint everywhere
    show through from the back.
    """
    small, factor = grey, 1
    while factor < _REDUCTION and small.size >= 4 * _REDUCED_PIXELS:
        small, factor = _halved(small), 2 * factor
    if light_on_dark is None:
        light_on_dark = is_light_on_dark(small)
    if light_on_dark:
        grey, small = np.asarray(cv2.bitwise_not(grey), np.uint8), 255 - small
    paper = _find_paper(small, _WINDOW_PX / factor)
    height, width = (factor * side for side in small.shape)
    levels = _levels(paper.divided(np.ascontiguousarray(grey[:height:factor, :width:factor])))
    if levels is None:
        blank = functools.partial(np.full_like, grey, 255)
        return Paper(np.zeros(grey.shape, np.bool_), light_on_dark, blank)
    darkest, faint = _parted_from_faint(paper.divided(_darkest(grey)), levels)
    if levels.middle - levels.threshold <= _PALE * levels.middle:
        levels = _nearer_to_thin_strokes(paper.divided(grey[:height:factor]), levels)
    limit = _limits(darkest, levels)
    ink = _ink_below(grey, paper.at(limit, faint))
    clean = functools.partial(_cleaned, grey, paper, faint, levels)
    return Paper(ink, light_on_dark, clean)


def is_light_on_dark(grey: Grey) -> bool:
    """Return whether a page is printed light on dark.

    Around print most pixels are paper: the few of ink lie far from the mean, on its dark side for
    dark print. The third moment of the levels in a window gives the side; it is small or cancels
    without print, or at the edge of a sheet on a darker table.
    """
    step = max(1, round(math.sqrt(grey.size / _DIRECTION_PIXELS)))
    small = grey[::step, ::step].astype(np.float32)
    side = max(3, round(math.sqrt(small.size) / _WINDOWS)) | 1
    window = (side, side)
    mean = cv2.blur(small, window)
    square = cv2.blur(small * small, window)
    cube = cv2.blur(small * small * small, window)
    # A power is slower than products.
    variance = np.maximum(square - mean * mean, 1.0)
    third = cube - mean * (3 * square - 2 * mean * mean)
    return bool((third / variance).sum() > _LEAST_SKEW * np.sqrt(variance).sum())


def reduced(grey: Grey, pixels: int) -> Grey:
    """Return an image of at most so many pixels, averaged."""
    factor = math.sqrt(grey.size / pixels)
    if factor <= 1:
        return grey
    size = (max(1, round(grey.shape[1] / factor)), max(1, round(grey.shape[0] / factor)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)


def _halved(grey: Grey) -> Grey:
    """Return an image of half the size, averaged; a whole factor is fastest."""
    height, width = (max(1, side // 2) for side in grey.shape)
    even = grey[: 2 * height, : 2 * width]
    return np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


@dataclass(frozen=True)
class _Paper:
    """Level of the paper, (h, w) uint8, and the level below which an area is none."""

    level: Grey
    darkest: float

    @functools.cached_property
    def _whole(self) -> bool:
        return bool(self.level.min() >= self.darkest)

    def divided(self, grey: Grey) -> Grey:
        """Return an image of the page, of any size, divided by its paper; 255 where is none."""
        height, width = grey.shape
        if height == len(self.level) and width // _POOL == self.level.shape[1]:
            wide = _widened(self.level, width)
        else:
            wide = np.asarray(cv2.resize(self.level, (width, height)), np.uint8)
        # New memory costs more than arithmetic.
        if self._whole:
            return np.asarray(cv2.divide(grey, wide, dst=wide, scale=_PAPER), np.uint8)
        _, none = cv2.threshold(wide, self.darkest, 255, cv2.THRESH_BINARY_INV)
        flat = cv2.divide(grey, wide, dst=wide, scale=_PAPER)
        return np.asarray(cv2.max(flat, none, dst=flat), np.uint8)

    def at(self, limit: NDArray[np.float32], faint: Grey | None) -> Grey:
        """Return the levels of the page, (h, w) uint8, below which it is ink, from those of the
        divided page up to which it is; 0 where is no paper, or faint ink."""
        level = cv2.resize(self.level, limit.shape[::-1], interpolation=cv2.INTER_LINEAR)
        # The nearest whole number of the divided page counts.
        part = cv2.multiply(limit + 0.5, level, scale=1 / _PAPER, dtype=cv2.CV_32F)
        below = cv2.convertScaleAbs(part, beta=0.5)
        if not self._whole:
            below[level < self.darkest] = 0
        return np.asarray(below if faint is None else cv2.subtract(below, faint), np.uint8)


def _find_paper(small: Grey, side: float) -> _Paper:
    """Return the paper of a page, as it would look without ink."""
    side = min(side, math.sqrt(small.size) / _LEAST_WINDOWS)
    near, far = _closed(small, side), _closed(_halved(_halved(small)), _WIDER * side / 4)
    far = np.asarray(cv2.resize(far, near.shape[::-1]), np.uint8)
    solid = near < cv2.convertScaleAbs(far, alpha=_SOLID)
    paper = np.where(_inside(solid), far, near) if solid.any() else near
    # Interpolation would extend the paper beyond the edge of a sheet.
    around = np.ones((5, 5), np.uint8)
    lowest, highest = cv2.erode(paper, around), cv2.dilate(paper, around)
    ends = cv2.compare(lowest, cv2.convertScaleAbs(highest, alpha=_STEP), cv2.CMP_LT)
    paper = np.asarray(cv2.copyTo(lowest, ends, paper), np.uint8)
    counts = _histogram(np.ascontiguousarray(paper[::2, ::2])).cumsum()
    brightest = float(np.searchsorted(counts, 0.95 * counts[-1]))
    return _Paper(paper, max(_DARKEST, _LEAST_LIGHT * brightest))


def _inside(areas: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the areas that do not touch the edge of the image, as a table or a scanner does."""
    count, labels = cv2.connectedComponents(areas.view(np.uint8), connectivity=8)
    kept = np.full(count, True)
    kept[0] = False
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        kept[edge] = False
    return np.asarray(kept[labels], np.bool_)


def _closed(small: Grey, side_px: float) -> Grey:
    """Return an image without dark spots narrower than a window."""
    side = max(3, round(side_px)) | 1
    square = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    # Closing follows the brightest grains unless they are smoothed.
    calm = cv2.blur(small, (3, 3))
    closed = cv2.morphologyEx(calm, cv2.MORPH_CLOSE, square, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.blur(closed, (3, 3), dst=closed), np.uint8)


@dataclass(frozen=True)
class _Levels:
    """Levels of a divided page: full ink, faintest peak of a spot, end of ink, start of paper,
    paper itself; and the standard deviation of its grain."""

    black: float
    seen: float
    threshold: float
    white: float
    middle: float
    grain: float


def _levels(pixels: Grey) -> _Levels | None:
    """Return the levels of ink and paper in some pixels of a divided page; None without ink."""
    counts = _histogram(pixels)
    # Level 255 marks areas without paper.
    counts[255] = 0
    bright = np.where(_LEVEL > _BRIGHT * _PAPER, counts, 0).cumsum()
    quarters = np.array([1, 2, 3]) / 4 * bright[-1]
    low, middle, high = np.interp(quarters, bright, _LEVEL + 0.5).tolist()
    grain = max((high - low) / _QUARTILES, 1.0)
    grains = _LEAST_GRAINS * grain
    darker = middle - max(_LEAST_CONTRAST / 2 * _PAPER, grains)
    if counts[: max(0, math.ceil(darker))].sum() < _FEWEST or not bright[-1]:
        return None
    otsu = middle - _otsu(counts)
    part = min(max(otsu / middle / _EVEN_INK, _LEAST_PART), 1.0)
    threshold = middle - min(max(_GRAINS * grain, part * otsu), _MOST_PART * otsu)
    ink = counts[: int(threshold) + 1]
    total = float(ink.sum())
    contrast = middle - float(ink @ _LEVEL[: len(ink)]) / max(total, 1)
    if not total or contrast < max(_LEAST_CONTRAST * _PAPER, grains):
        return None
    black, dark = np.searchsorted(ink.cumsum(), np.array([0.2, _DARKER_QUARTER]) * total)
    white = middle - max(2.5 * grain, 0.03 * _PAPER)
    seen = middle - _THROUGH * (middle - dark)
    return _Levels(float(black), seen, threshold, white, middle, grain)


def _histogram(grey: Grey) -> NDArray[np.float64]:
    """Return the number of pixels of each level, (256,)."""
    counts = cv2.calcHist([grey], [0], None, [256], [0, 256])
    return np.asarray(counts.ravel(), np.float64)


def _otsu(counts: NDArray[np.float64]) -> int:
    """Return the last level of the darker class (Otsu 1979: most variance between classes)."""
    below, moment = counts.cumsum(), (counts * _LEVEL).cumsum()
    between = (moment * below[-1] - below * moment[-1]) ** 2
    return int((between / np.maximum(below * (below[-1] - below), 1)).argmax())


def _nearer_to_thin_strokes(rows: Grey, levels: _Levels) -> _Levels:
    """Return levels whose ink begins nearer to the paper if strokes are thin, pale and soft, but
    before strokes merge or appear from the paper's grain."""
    first, last = int(levels.threshold), int(levels.middle - _NEAREST_GRAINS * levels.grain)
    ink = rows <= first
    area, count = np.count_nonzero(ink), np.count_nonzero(ink[:, 1:] != ink[:, :-1])
    if not _PEN_PX[0] * count < 2 * area < _PEN_PX[1] * count:
        return levels
    if last <= first or np.count_nonzero(rows <= last) - area <= _SOFT_PX * count:
        return levels
    after, before = rows[:, 1:], rows[:, :-1]
    edges = np.cumsum(_histogram(np.minimum(after, before)) - _histogram(np.maximum(after, before)))
    strokes = edges[first : last + 1] / edges[first]
    other = np.flatnonzero((strokes < _STROKES[0]) | (strokes > _STROKES[1]))
    nearest = first + (int(other[0]) - 1 if len(other) else last - first)
    return replace(levels, threshold=max(levels.threshold, float(nearest)))


def _limits(darkest: Grey, levels: _Levels) -> NDArray[np.float32]:
    """Return the levels up to which is ink, (h, w), in cells whose darkest pixels are given: on
    calm paper they follow those of the cells around."""
    followed = min(max((_GRAINY - levels.grain) / (_GRAINY - _CALM), _STAINED), 1.0)
    _, here = cv2.threshold(darkest, levels.threshold, 255, cv2.THRESH_BINARY_INV)
    count = cv2.countNonZero(here)
    if not (followed and count):
        return np.full(darkest.shape, levels.threshold, np.float32)
    contrast = cv2.min(here, cv2.subtract(np.full_like(darkest, levels.middle), darkest))
    part, sums = (
        cv2.blur(_halved(_halved(np.asarray(each, np.uint8))).astype(np.float32), _AROUND)
        for each in (here, contrast)
    )
    usual = cv2.sumElems(contrast)[0] / (255 * count)
    relative = np.where(part > 0, sums / np.maximum(part, 1e-3) / usual, 1)
    factor = np.clip(np.maximum(relative, 0.1) ** followed, *_LOCAL)
    limit = levels.middle - (levels.middle - levels.threshold) * factor
    # Where all ink is black, the limit of the darkest would be negative.
    limit = np.clip(limit, 0, max(levels.white, levels.threshold)).astype(np.float32)
    return np.asarray(cv2.resize(limit, darkest.shape[::-1]), np.float32)


def _ink_below(grey: Grey, below: Grey) -> NDArray[np.bool_]:
    """Return the ink, (H, W) bool: what is darker than the levels of its cells."""
    height, width = grey.shape
    wide = _widened(below, width)[:, None]
    ink = np.empty(grey.shape, np.bool_)
    whole = min(height, _POOL * len(below))
    cells = (len(below), whole // len(below), width)
    np.less(grey[:whole].reshape(cells), wide, out=ink[:whole].reshape(cells))
    np.less(grey[whole:], wide[-1], out=ink[whole:])
    return ink


def _widened(cells: Grey, width: int) -> Grey:
    """Return cells of 4 x 4 as rows of pixels: four equal bytes each, the last as far as needed."""
    cells = np.hstack([cells, cells[:, -1:]])
    return (cells * np.uint32(0x01010101)).view(np.uint8)[:, :width]


def _darkest(grey: Grey) -> Grey:
    """Return the darkest pixel of each cell of 4 x 4."""
    height, width = (max(1, side // _POOL) for side in grey.shape)
    # Rows, then columns: faster than a window.
    rows = [grey[k : _POOL * height : _POOL, : _POOL * width] for k in range(_POOL)]
    lowest = functools.reduce(np.minimum, [row for row in rows if len(row) == height])
    across = cv2.erode(lowest, np.ones((1, _POOL), np.uint8), anchor=(0, 0))
    return np.ascontiguousarray(across[:, ::_POOL][:, :width])


def _parted_from_faint(darkest: Grey, levels: _Levels) -> tuple[Grey, Grey | None]:
    """Return the cells without spots of ink that are faint everywhere, and those, as 255."""
    ink = darkest <= levels.threshold
    count, labels = cv2.connectedComponents(ink.view(np.uint8), connectivity=8)
    faint = np.full(count, 255, np.uint8)
    cells = np.flatnonzero(ink)
    label = labels.ravel()[cells]
    faint[label[darkest.ravel()[cells] <= levels.seen]] = 0
    if not faint[1:].any():
        return darkest, None
    spots = np.zeros(darkest.shape, np.uint8)
    spots.ravel()[cells] = faint[label]
    return np.asarray(cv2.max(darkest, spots), np.uint8), spots


def _cleaned(grey: Grey, paper: _Paper, faint: Grey | None, levels: _Levels) -> Grey:
    """Return a page with white paper and black ink, without spots that are faint."""
    flat = paper.divided(grey)
    if faint is not None:
        wide = cv2.resize(faint, grey.shape[::-1], interpolation=cv2.INTER_NEAREST)
        cv2.max(flat, wide, dst=flat)
    gain, black = 255 / (levels.white - levels.black), levels.black
    return np.asarray(cv2.addWeighted(flat, gain, flat, 0, -gain * black, dst=flat), np.uint8)


_LEAST_SIDE = 1.5  # least side of a panel, in usual heights of letters
_LEAST_DARK = 0.35  # least part of a panel's box that is dark
_LEAST_BOX = 0.8
"""Least part of its box that a panel and its contents fill; touching letters have less."""
_FEWEST_LIGHT = 4  # fewest light letters; two large touching letters have at most as many holes
_LETTER = (0.5, 9.0)
"""Range of their usual height, in usual heights of the letters of the page: halftones have less,
and what is larger is a window in the panel."""
_SIDES = ("left", "top", "right", "bottom")
_HALF = 127  # of four pixels two are ink
_BLACK = np.uint8(40)  # level below which a panel's grain is cut off


def turn_panels(paper: Paper) -> Paper:
    """Return a page with its panels made dark on light as well."""
    spots, height = paper.spots, paper.letter_height
    if height is None:
        return paper
    large = np.minimum(spots.width, spots.height) > _LEAST_SIDE * height
    large &= spots.width > 2 * _LEAST_SIDE * height
    large &= spots.area > _LEAST_DARK * spots.width * spots.height
    chosen = spots.of(large)
    boxes = np.column_stack([getattr(chosen, side) for side in _SIDES]).tolist()
    return turn_boxes(paper, list(zip(boxes, chosen.area.tolist(), strict=True)), height)


def turn_boxes(paper: Paper, boxes: list[tuple[list[int], int]], height: float) -> Paper:
    """Return a page with the panels made dark on light that are in some boxes, each with its least
    area, px; letters of the page are so high."""
    panels: list[list[int]] = []
    for sides, area in boxes:
        left, top, right, bottom = sides
        box = np.s_[top:bottom, left:right]
        panel = _panel(paper.ink[box], area, height)
        if panel is None:
            continue
        if not panels:
            ink, cleaned = paper.ink.copy(), paper.cleaned.copy()
        panels.append(sides)
        ink[box] ^= panel
        # Its blurred edge would become a frame.
        inside = cv2.erode(panel.view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
        ink[box] &= inside | ~panel
        above = np.maximum(cleaned[box], _BLACK) - _BLACK
        negative = 255 - cv2.convertScaleAbs(above, alpha=255 / (255 - int(_BLACK)))
        cleaned[box] = np.where(panel, np.where(inside, negative, 255), cleaned[box])
    if not panels:
        return paper
    return replace(paper, ink=ink, clean=lambda: cleaned, panels=tuple(panels))


def _panel(ink: NDArray[np.bool_], area: int, height: float) -> NDArray[np.bool_] | None:
    """Return the mask of a panel, without windows, in a spot's box of ink, (h, w) bool, or None."""
    outlines, nested = cv2.findContours(ink.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    outer = max(
        (k for k in range(len(outlines)) if nested[0, k, 3] < 0),
        key=lambda k: cv2.contourArea(outlines[k]),
    )
    filled = cv2.drawContours(np.zeros(ink.shape, np.uint8), outlines, outer, 1, cv2.FILLED)
    if filled.sum() < max(_LEAST_BOX * ink.size, area):
        return None
    holes = find_spots((filled > 0) & ~ink)
    usual = usual_height(holes, ink.shape)
    if usual is None or not _LETTER[0] * height < usual < _LETTER[1] * height:
        return None
    if np.count_nonzero((holes.height > usual / 2) & (holes.height < 2 * usual)) < _FEWEST_LIGHT:
        return None
    for k, outline in enumerate(outlines):
        _, _, wide, high = cv2.boundingRect(outline)
        window = high > _LETTER[1] * height or wide > 2 * _LETTER[1] * height
        if window and nested[0, k, 3] == outer:
            cv2.drawContours(filled, outlines, k, 0, cv2.FILLED)
    return np.asarray(filled > 0, np.bool_)
