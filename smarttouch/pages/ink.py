"""Separation of ink from paper, under any light, and of light print in dark panels."""

import functools
import math
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
_QUARTILES = 1.349  # between the quartiles of a normal distribution, in standard deviations
_BRIGHT = 0.7  # part of the paper's level above which pixels are mostly paper


@dataclass(frozen=True, eq=False)
class Paper:
    """Page as dark on light, (H, W): paper exactly 255, ink near 0; and the mask of its ink."""

    cleaned: Grey
    ink: NDArray[np.bool_]  # (H, W); empty on blank paper
    light_on_dark: bool  # as printed; inverted here
    panels: tuple[list[int], ...] = ()
    """Panels of the other polarity that were turned as well: left, top, right, bottom, px."""

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
        return Paper(_halved(self.cleaned), part >= _HALF, self.light_on_dark)


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
    flat = _divided(grey, small, _WINDOW_PX / factor)
    levels = _levels(flat)
    if levels is None:
        blank = np.full_like(grey, 255)
        return Paper(blank, np.zeros(grey.shape, np.bool_), light_on_dark)
    darkest = _without_faint_spots(flat, levels)
    levels = _nearer_to_thin_strokes(flat, levels)
    ink = _ink_below(flat, darkest, levels)
    gain = 255 / (levels.white - levels.black)
    cleaned = cv2.addWeighted(flat, gain, flat, 0, -gain * levels.black, dst=flat)
    return Paper(np.asarray(cleaned, np.uint8), ink, light_on_dark)


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


def _divided(grey: Grey, small: Grey, side: float) -> Grey:
    """Return the page divided by its paper; blank where it is too dark to be paper."""
    side = min(side, math.sqrt(small.size) / _LEAST_WINDOWS)
    near, far = _closed(small, side), _closed(_halved(small), _WIDER * side / 2)
    far = np.asarray(cv2.resize(far, near.shape[::-1]), np.uint8)
    solid = near < cv2.convertScaleAbs(far, alpha=_SOLID)
    paper = np.where(_inside(solid), far, near) if solid.any() else near
    # Interpolation would extend the paper beyond the edge of a sheet.
    around = np.ones((5, 5), np.uint8)
    lowest, highest = cv2.erode(paper, around), cv2.dilate(paper, around)
    paper = np.where(lowest < cv2.convertScaleAbs(highest, alpha=_STEP), lowest, paper)
    counts = np.cumsum(_histogram(paper))
    darkest = max(_DARKEST, _LEAST_LIGHT * float(np.searchsorted(counts, 0.95 * counts[-1])))
    wide = cv2.resize(paper, grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    if paper.min() >= darkest:
        # New memory costs more than arithmetic.
        return np.asarray(cv2.divide(grey, wide, dst=wide, scale=_PAPER), np.uint8)
    _, no_paper = cv2.threshold(wide, darkest, 255, cv2.THRESH_BINARY_INV)
    return np.asarray(cv2.max(cv2.divide(grey, wide, dst=wide, scale=_PAPER), no_paper), np.uint8)


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


def _levels(flat: Grey) -> _Levels | None:
    """Return the levels of ink and paper; None without ink."""
    counts = _histogram(flat[::_POOL])
    # Level 255 marks areas without paper.
    counts[255] = 0
    level = np.arange(256)
    bright = np.where(level > _BRIGHT * _PAPER, counts, 0)
    low, middle, high = np.searchsorted(np.cumsum(bright), np.array([1, 2, 3]) / 4 * bright.sum())
    grain = max(float(high - low) / _QUARTILES, 1.0)
    dark = level < middle - max(_LEAST_CONTRAST / 2 * _PAPER, _LEAST_GRAINS * grain)
    if counts[dark].sum() < _FEWEST or not bright.any():
        return None
    otsu = middle - _otsu(counts)
    part = np.clip(otsu / middle / _EVEN_INK, _LEAST_PART, 1)
    threshold = middle - np.clip(_GRAINS * grain, part * otsu, _MOST_PART * otsu)
    ink = np.where(level <= threshold, counts, 0)
    mean = float((ink * level).sum() / ink.sum())
    if middle - mean < max(_LEAST_CONTRAST * _PAPER, _LEAST_GRAINS * grain):
        return None
    black, darker = np.searchsorted(np.cumsum(ink), np.array([0.2, _DARKER_QUARTER]) * ink.sum())
    white = middle - max(2.5 * grain, 0.03 * _PAPER)
    seen = middle - _THROUGH * (middle - darker)
    return _Levels(float(black), seen, threshold, white, float(middle), grain)


def _histogram(grey: Grey) -> NDArray[np.float64]:
    """Return the number of pixels of each level, (256,)."""
    counts = cv2.calcHist([np.ascontiguousarray(grey)], [0], None, [256], [0, 256])
    return np.asarray(counts.ravel(), np.float64)


def _otsu(counts: NDArray[np.float64]) -> int:
    """Return the last level of the darker class (Otsu 1979: most variance between classes)."""
    level = np.arange(len(counts))
    below = np.cumsum(counts)
    moment = np.cumsum(counts * level)
    above = below[-1] - below
    both = below * above
    between = (moment * below[-1] - below * moment[-1]) ** 2
    return int(np.divide(between, both, out=np.zeros_like(both), where=both > 0).argmax())


def _nearer_to_thin_strokes(flat: Grey, levels: _Levels) -> _Levels:
    """Return levels whose ink begins nearer to the paper if strokes are thin, pale and soft, but
    before strokes merge or appear from the paper's grain."""
    if levels.middle - levels.threshold > _PALE * levels.middle:
        return levels
    rows = np.ascontiguousarray(flat[::_POOL])
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


def _ink_below(flat: Grey, darkest: Grey, levels: _Levels) -> NDArray[np.bool_]:
    """Return the ink, (H, W) bool: below a threshold that follows the darkest pixels of the cells
    around on calm paper."""
    followed = float(np.clip((_GRAINY - levels.grain) / (_GRAINY - _CALM), _STAINED, 1))
    _, here = cv2.threshold(darkest, levels.threshold, 255, cv2.THRESH_BINARY_INV)
    if not (followed and here.any()):
        _, below = cv2.threshold(flat, levels.threshold, 1, cv2.THRESH_BINARY_INV)
        return np.asarray(below, np.uint8).view(np.bool_)
    contrast = cv2.min(here, cv2.subtract(np.full_like(darkest, levels.middle), darkest))
    size = tuple(max(1, side // _POOL) for side in here.shape[::-1])
    part, sums = (
        cv2.blur(cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float32), _AROUND)
        for each in (here, contrast)
    )
    usual = cv2.mean(contrast, here)[0] / 255
    relative = np.where(part > 0, sums / np.maximum(part, 1e-3) / usual, 1)
    factor = np.clip(np.maximum(relative, 0.1) ** followed, *_LOCAL)
    limit = levels.middle - (levels.middle - levels.threshold) * factor
    # Where all ink is black, the limit of the darkest would be negative.
    limit = np.clip(np.rint(limit), 0, max(levels.white, levels.threshold)).astype(np.uint8)
    # The same for the rows of a cell.
    rows = cv2.resize(limit, (flat.shape[1], len(darkest)))
    ink = np.empty(flat.shape, np.bool_)
    for k in range(_POOL):
        cells = flat[k::_POOL]
        # The last rows are less than a cell.
        np.less_equal(cells[: len(rows)], rows[: len(cells)], out=ink[k::_POOL][: len(rows)])
        np.less_equal(cells[len(rows) :], rows[-1], out=ink[k::_POOL][len(rows) :])
    return ink


def _without_faint_spots(flat: Grey, levels: _Levels) -> Grey:
    """Make spots of ink that are faint everywhere white, with their surroundings; return the
    darkest pixel of each cell of 4 x 4 that is left."""
    height, width = (max(1, side // _POOL) for side in flat.shape)
    rows = [flat[k : _POOL * height : _POOL, : _POOL * width] for k in range(_POOL)]
    # Rows, then columns: faster than a window.
    lowest = functools.reduce(np.minimum, [row for row in rows if len(row) == height])
    across = cv2.erode(lowest, np.ones((1, _POOL), np.uint8), anchor=(0, 0))
    lowest = np.ascontiguousarray(across[:, ::_POOL][:, :width])
    _, ink = cv2.threshold(lowest, levels.threshold, 255, cv2.THRESH_BINARY_INV)
    count, labels = cv2.connectedComponents(ink, connectivity=8)
    faint = np.full(count, 255, np.uint8)
    faint[labels[lowest <= levels.seen]] = 0
    faint[0] = 0
    if not faint.any():
        return lowest
    spots = np.take(faint, np.asarray(labels), mode="clip")
    wide = cv2.resize(spots, (lowest.shape[1] * _POOL, height), interpolation=cv2.INTER_NEAREST)
    for row in rows:
        if row.shape == wide.shape:
            cv2.max(row, wide, dst=row)
    return np.asarray(cv2.max(lowest, spots), np.uint8)


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
    ink, cleaned, panels = paper.ink, paper.cleaned, []
    for sides, area in boxes:
        left, top, right, bottom = sides
        box = np.s_[top:bottom, left:right]
        panel = _panel(paper.ink[box], area, height)
        if panel is None:
            continue
        if ink is paper.ink:
            ink, cleaned = ink.copy(), cleaned.copy()
        panels.append(sides)
        ink[box] ^= panel
        # Its blurred edge would become a frame.
        inside = cv2.erode(panel.view(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
        ink[box] &= inside | ~panel
        above = np.maximum(cleaned[box], _BLACK) - _BLACK
        negative = 255 - cv2.convertScaleAbs(above, alpha=255 / (255 - int(_BLACK)))
        cleaned[box] = np.where(panel, np.where(inside, negative, 255), cleaned[box])
    return replace(paper, ink=ink, cleaned=cleaned, panels=tuple(panels)) if panels else paper


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
