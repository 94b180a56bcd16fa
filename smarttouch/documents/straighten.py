"""Straightening of pages: a photographed sheet seen from above, text turned level."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.ink import Grey, reduced, separate_ink
from smarttouch.documents.letters import Spots, letters_alone
from smarttouch.documents.page_image import Page
from smarttouch.documents.rows import neighbors
from smarttouch.documents.sheet import find_sheet, flattened

MOST_SKEW_DEG = 15.0
QUARTER = "the text ran up or down the page, which was turned by 90°"
"""Note of a turn by a quarter, counterclockwise."""
LEAST_SKEW_DEG = 0.2
"""Least skew worth correcting: lines are followed through less."""
_REDUCED_PIXELS = 2_000_000
"""Size of the image in which skew is measured: letters of an A4 page are 10 pixels high."""
_COARSE_DEG, _FINE_DEG = 0.5, 0.05
_POINTS = 30_000
_FEWEST_LETTERS = 8  # fewest letters that determine the direction of the text
_BINS = 5.0  # rows per letter height in which ink is counted
_FAR = 3.2  # gap assumed where there is none, in letter heights
_TOUCHING = 0.1  # gap of touching letters, in letter heights
_EDGE_MEANS = 40  # places across a page at which the grey of its edges is averaged
_LEAST_RISE = 0.3  # least rise of a line over its whole length, in letter heights
_LEAST_CONTRAST = 3.2
"""Least contrast of rows along the text, relative to other directions; pictures have up to 2.9."""
_CLEARLY = 0.6  # least log ratio by which letters are closer in columns than in rows


def straighten(page: Page, quarter: bool = True) -> tuple[Page, list[str]]:
    """Return a page with its text level, and the corrections, one sentence each.

    The sheet of a photograph is laid flat; text that runs up or down is turned by a quarter, if
    allowed; what is left of skew, up to 15°, is turned level. A page that needs no correction is
    returned as it is. Whether it is upside down is not examined.
    """
    notes = []
    corners = find_sheet(page.grey)
    if corners is not None:
        page = Page(flattened(page.grey, corners), page.mm_per_pixel)
        notes.append("the sheet of paper was cut out of the photograph and laid flat")
    found = letters_alone(separate_ink(reduced(page.grey, _REDUCED_PIXELS)).ink)
    if found is None or len(found[1].area) < _FEWEST_LETTERS:
        return page, notes
    ink, letters, height = found
    downwards = quarter and _runs_downwards(letters)
    if downwards:
        ink, letters = np.rot90(ink), letters.transposed
        height = letters.usual_height
    skew_deg, contrast = measure_skew(ink, height)
    if contrast < _LEAST_CONTRAST:
        return page, notes
    if abs(skew_deg) < _least_skew_deg(letters, height):
        skew_deg = 0.0
    if not (downwards or skew_deg):
        return page, notes
    if downwards:
        notes.append(QUARTER)
    if skew_deg:
        notes.append(f"the text was tilted by {abs(skew_deg):.1f}° and was turned level")
    return Page(_turned(page.grey, downwards, skew_deg), page.mm_per_pixel), notes


def measure_skew(ink: NDArray[np.bool_], height: float) -> tuple[float, float]:
    """Return the clockwise skew of the ink of letters, (H, W) bool, at most 15°, and its contrast.

    Ink is counted in rows along many directions: along the lines of text, full and empty rows
    differ most (projection profiles, Postl 1986). How much more than along the usual direction
    shows whether there is text at all.
    """
    points = np.argwhere(ink)
    points = points[:: max(1, len(points) // _POINTS)]
    down, across = (points * (_BINS / height)).T

    def contrast(degrees: float) -> float:
        turned = down - across * math.tan(math.radians(degrees))
        rows = np.bincount((turned - turned.min()).astype(np.intp)).astype(np.float64)
        return float(np.square(np.diff(rows)).sum())

    coarse = np.arange(-MOST_SKEW_DEG, MOST_SKEW_DEG + _COARSE_DEG / 2, _COARSE_DEG)
    found = np.array([contrast(degrees) for degrees in coarse])
    fine = coarse[found.argmax()] + np.arange(-_COARSE_DEG, _COARSE_DEG, _FINE_DEG)
    finest = np.array([contrast(degrees) for degrees in fine])
    return float(fine[finest.argmax()]), float(finest.max() / max(np.median(found), 1.0))


def _runs_downwards(letters: Spots) -> bool:
    """Return whether letters follow each other down the page instead of across it.

    Letters of a word are closest along the line; words that have run together are long.
    """
    gaps = []
    for each in (letters, letters.transposed):
        links = neighbors(each)
        taller = np.maximum(each.height[links.first], each.height[links.second])
        apart = np.maximum(links.gap, 0) / taller
        gaps.append(float(np.median(apart)) if len(apart) else _FAR)
    along, down = (math.log(gap + _TOUCHING) for gap in gaps)
    longer = float(np.average(np.log(letters.width / letters.height), weights=letters.area))
    return down - along + 2 * longer < -_CLEARLY


def _least_skew_deg(letters: Spots, height: float) -> float:
    """Return the least measurable skew: little text determines its direction poorly."""
    left, right = np.percentile(letters.left, 2), np.percentile(letters.right, 98)
    return max(LEAST_SKEW_DEG, math.degrees(_LEAST_RISE * height / max(float(right - left), 1.0)))


def _turned(grey: Grey, quarter: bool, skew_deg: float) -> Grey:
    """Rotate a page back; it grows, and the new area is filled with its paper."""
    if quarter:
        grey = np.ascontiguousarray(np.rot90(grey))
    if not skew_deg:
        return grey
    height, width = grey.shape
    angle = math.radians(skew_deg)
    cos, sin = math.cos(angle), abs(math.sin(angle))
    size = (math.ceil(width * cos + height * sin), math.ceil(height * cos + width * sin))
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), skew_deg, 1)
    matrix[:, 2] += (size[0] - width) / 2, (size[1] - height) / 2
    turned = cv2.warpAffine(
        _softly_edged(grey), matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(turned, np.uint8)


def _softly_edged(grey: Grey) -> Grey:
    """Return a page whose outermost pixels are local means, for repetition as a border."""
    coarse = cv2.resize(grey, (_EDGE_MEANS, _EDGE_MEANS), interpolation=cv2.INTER_AREA)
    soft = cv2.resize(coarse, grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    soft[1:-1, 1:-1] = grey[1:-1, 1:-1]
    return np.asarray(soft, np.uint8)
