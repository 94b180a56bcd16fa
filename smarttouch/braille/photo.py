"""Recognition of Braille on a photographed page."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError
from smarttouch.braille.cell_detection import (
    cell_lines,
    cell_pitch,
    cells_of,
    find_cells,
    looked_at,
    slope_of,
)
from smarttouch.braille.page_dots import look_again
from smarttouch.braille.sides import SURE, unmirrored_odds
from smarttouch.pages.page_image import Page

LEAST_CERTAINTY = 0.6
"""Least certainty of a page that is read."""
CERTAIN = 0.7
"""Least certainty of Braille on a page of unknown kind."""
DISTURBED = 0.83
"""Certainty below which the reader is warned."""
FEWEST_CELLS = 4
LEAST_SHARE = 0.03
"""Least part of the paper that cells cover on a page of unknown kind."""
_ENOUGH = 0.1  # covered part above which no other scale is tried
CELL_HEIGHT = 1.6
"""Height of a line, in distances of cells."""
_SIDES_PX = (980, 1370, 700, 1900, 500, 350, 250)
"""Longer sides to which a page is scaled in turn: its lines may be many or few."""
_PITCH_PX = 25.0  # distance of cells at which they are read, in the middle of the network's range
_TURNS_DEG = (-15.0, 15.0)
_MOST_ENLARGED = 1.5  # largest enlargement of a picture
_TILE_PX = 224
_TILES = ((0.5, 0.5), (0.28, 0.3), (0.72, 0.7))  # centers of the tiles by which a view is judged
_LEVEL_DEG = 1.0  # slope of lines above which a page is turned
_LEAST_READ = 0.65  # least certainty of a position where a cell is read: false ones move lines
_OTHER_SIDE = 0.2  # least lead in certainty by which dots lit from below count as the raised ones
_BOTH_SIDES = 0.3  # least score of the dots of one side beside the other's
_TELLING = 0.2  # least log odds per cell by which a mirror image is known
_SOME = 0.25  # part of a page's height by which the sides are told apart, if that is enough
_BEHIND = 0.8  # above these, and with no other side to read, a page is refused


@dataclass(frozen=True, eq=False)
class BraillePage:
    """Cells of a page of Braille."""

    lines: list[str]  # without trailing blanks; empty where there is room for a line
    cells_px: NDArray[np.float64]  # (N, 2), middles: column and row
    patterns: NDArray[np.int_]  # (N,), bit k is dot k + 1
    certainty: float  # mean over the cells
    notes: list[str]
    light_from_deg: float = math.nan  # as its dots show it; not a number if they are few


class _View(NamedTuple):
    """Scale and turn of a page, and the cells found there."""

    scale: float
    turn_deg: float
    share: float  # part of the paper that is covered by cells
    certainty: float

    @property
    def score(self) -> float:
        """Certainty counts twice: a wrong scale gives many uncertain cells."""
        return self.certainty**2 * min(1.0, self.share / _ENOUGH)


def read_braille(page: Page, light_from_deg: float | None = None) -> BraillePage:
    """Read a photograph or scan of a page of Braille, raised or printed, turned by up to 25°.

    The page's scale is not used: cells show their own. ``light_from_deg`` is the direction of the
    light, 0 the right and 90 the top of the picture, which separates dots of the front from those
    of the back. If it is not given, the side whose cells are not mirrored is the front; a page
    that shows its back only is refused, or noted where that is not sure.
    """
    if light_from_deg is not None and not math.isfinite(light_from_deg):
        raise PageError(
            f"light from {light_from_deg:g}°: give 0 for the right, 90 for the top",
            about="light_from_deg",
        )
    if light_from_deg is None:
        below, read, note = _front(page.grey)
    else:
        below, note = light_from_deg % 360 > 180, None
        grey = 255 - page.grey if below else page.grey
        read = _looked_at(grey, _best_view(grey, _TURNS_DEG))
    seen = look_again(cells_of(read.opinion, _LEAST_READ), read.even, read.opinion)
    lines, kept = cell_lines(seen.found)
    agreed, patterns = seen.agreed[kept], seen.found.patterns[kept]
    certainty = float(agreed.mean()) if kept else 0.0
    if len(kept) < FEWEST_CELLS or certainty < LEAST_CERTAINTY:
        raise PageError(
            f"only {agreed.sum():.0f} of {len(kept)} possible cells are certain: is "
            "it a page of Braille, upright, sharp and lit from one side?",
            about="page",
        )
    odds = unmirrored_odds(patterns)
    if odds < -max(_BEHIND * len(kept), SURE) and light_from_deg is None:
        raise PageError(
            f"these {len(kept)} cells are mirrored: the page shows its back. Turn the sheet over, "
            "or give the direction of the light",
            about="page",
        )
    notes = [note] if note else []
    if certainty < DISTURBED:
        notes.append(f"cells are certain to {certainty:.0%} only: some are wrong")
    if odds < -max(_TELLING * len(kept), SURE):
        notes.append("cells read as if they were mirrored: this may be the back of the sheet")
    cells_px = seen.found.px[kept] @ read.back[:, :2].T + read.back[:, 2]
    lit = seen.light_from_deg + 180 * below
    return BraillePage(lines, cells_px, patterns, certainty, notes, lit % 360)


class _LookedAt(NamedTuple):
    """A page in a view, by the network: the picture with normalized contrast, maps of cells, (9, H,
    W), and the map to the page's pixels, (2, 3)."""

    even: NDArray[np.float32]
    opinion: NDArray[np.float32]
    back: NDArray[np.float64]


def _front(grey: NDArray[np.uint8]) -> tuple[bool, _LookedAt, str | None]:
    """Return whether the dots of the front are lit from below, the page looked at for them, and a
    note where that is not sure."""
    view, inverted = _best_view(grey, _TURNS_DEG), 255 - grey
    sure = view.certainty > LEAST_CERTAINTY
    other = _glance(inverted, *view[:2]) if sure else _best_view(inverted)
    below = other.certainty > view.certainty + _OTHER_SIDE
    note = None
    if min(view.score, other.score) > _BOTH_SIDES * max(view.score, other.score):
        # Some lines show which side is mirrored; where they do not, all of both do.
        for part, telling in ((_SOME, 2), (1.0, 1)):
            both = [_looked_at(grey, view, part), _looked_at(inverted, other, part)]
            cells = [cells_of(each.opinion) for each in both]
            read = [each.patterns[cell_lines(each)[1]] for each in cells]
            lead = unmirrored_odds(read[0]) - unmirrored_odds(read[1])
            if abs(lead) > telling * max(_TELLING * sum(map(len, read)), SURE):
                below = lead < 0
                break
        else:
            note = (
                "dots of both sides are visible; those read are raised if the light comes from "
                f"{'below' if below else 'above'}: give its direction otherwise"
            )
    return below, _looked_at(inverted, other) if below else _looked_at(grey, view), note


def looks_like_braille(page: Page) -> bool:
    """Return whether parts of a page are certainly Braille, upright and lit from above."""
    view = _best_view(page.grey)
    return view.share > LEAST_SHARE and view.certainty > CERTAIN


def _best_view(grey: NDArray[np.uint8], turns_deg: tuple[float, ...] = ()) -> _View:
    """Return the scale and turn at which parts of a page show most cells."""
    views: list[_View] = []
    longest = max(grey.shape)
    for side_px in _SIDES_PX:
        if side_px < _MOST_ENLARGED * longest:
            views.append(_glance(grey, side_px / longest, 0.0))
            if views[-1].share > _ENOUGH and views[-1].certainty > CERTAIN:
                return views[-1]
    views.sort(key=lambda each: each.score, reverse=True)
    if views and views[0].certainty > LEAST_CERTAINTY:
        return views[0]
    turned = [_glance(grey, each.scale, turn_deg) for turn_deg in turns_deg for each in views[:2]]
    return max([*views, *turned], key=lambda each: each.score, default=_View(1.0, 0.0, 0.0, 0.0))


def _glance(grey: NDArray[np.uint8], scale: float, turn_deg: float) -> _View:
    """Return the view with the cells of some tiles, at the scale and turn that fit these."""
    picture, _ = _scaled(grey, scale, turn_deg)
    size = np.array(picture.shape)
    pitches, slopes, covered, sure = [], [], 0.0, list[float]()
    for middle in _TILES:
        top, left = np.clip(size * middle - _TILE_PX / 2, 0, np.maximum(size - _TILE_PX, 0)).astype(
            int
        )
        tile = np.ascontiguousarray(picture[top : top + _TILE_PX, left : left + _TILE_PX])
        found = find_cells(tile)
        pitch_px = cell_pitch(found.px)
        if pitch_px:
            pitches.append(pitch_px)
            slopes.append(slope_of(found.px, pitch_px))
            covered += float(found.certainty.sum()) * CELL_HEIGHT * pitch_px**2 / tile.size
            sure += found.certainty.tolist()
    if not pitches:
        return _View(scale, turn_deg, 0.0, 0.0)
    closer = float(np.clip(_PITCH_PX / np.median(pitches), 0.5, 2))
    level_deg = turn_deg + math.degrees(math.atan(np.median(slopes)))
    return _View(scale * closer, level_deg, covered / len(_TILES), float(np.mean(sure)))


def _looked_at(grey: NDArray[np.uint8], view: _View, part: float = 1.0) -> _LookedAt:
    """Look at a page, or that part of its height in the middle."""
    picture, back = _scaled(grey, view.scale, view.turn_deg)
    edge = round(len(picture) * (1 - part) / 2)
    return _LookedAt(*looked_at(picture[edge : len(picture) - edge]), back)


def _scaled(
    grey: NDArray[np.uint8], scale: float, turn_deg: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return a page scaled and turned, and the map of its pixels to the page's, (2, 3)."""
    size = tuple(max(16, round(scale * side)) for side in grey.shape[::-1])
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    picture = np.asarray(cv2.resize(grey, size, interpolation=way), np.uint8)
    back = np.array([[1 / scale, 0, 0.5 / scale - 0.5], [0, 1 / scale, 0.5 / scale - 0.5]])
    if abs(turn_deg) < _LEVEL_DEG:
        return picture, back
    width, height = size
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1)
    new = np.ceil(np.abs(turn[:, :2]) @ size).astype(int)
    turn[:, 2] += (new - size) / 2
    turned = cv2.warpAffine(picture, turn, new.tolist(), borderMode=cv2.BORDER_REPLICATE)
    unturn = np.asarray(cv2.invertAffineTransform(turn))
    return np.asarray(turned, np.uint8), np.column_stack(
        [back[:, :2] @ unturn[:, :2], back[:, :2] @ unturn[:, 2] + back[:, 2]]
    )
