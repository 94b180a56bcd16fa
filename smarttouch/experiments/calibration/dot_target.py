"""The printed target of dots, and its dots found in an image."""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from smarttouch.base.errors import CalibrationError, require_within
from smarttouch.base.files import write_bytes
from smarttouch.profile import Profile

LARGE_DOTS = ((0, -1), (0, 0), (0, 1), (1, 1))
"""Columns and rows of the large dots: an L, whose orientation is unambiguous."""
DOT_SHARE = 0.42
LARGE_SHARE = 0.7  # diameter of large dots, as a part of the pitch
FEWEST_PIXELS = 6  # fewest pixels across a pitch; with fewer, dots merge
FEWEST_PITCHES = 4  # fewest pitches across the field of view; with fewer, the L does not fit
PRINT_DPI = 1270
"""Resolution of the print, 50 dots a millimeter: every usual pitch is a whole number of them."""
_FINEST_MM = 0.01
_PITCHES_MM = (0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 50.0)
_WISHED_PITCHES = 5
_SPARE = 3
"""Dots beyond the field of view on each side, so that the target need not be laid exactly."""
_MOST_DOTS = 40
_MARGIN_MM = 8.0
_INCH_MM = 25.4


@dataclass(frozen=True)
class DotTarget:
    """Square grid of dots on paper.

    Columns and rows are counted right and down from the dot where the L has
    its middle: that one is laid under the middle of the array, with the L
    upright as one reads.
    """

    pitch_mm: float  # from dot to dot
    reach: int  # columns and rows on each side of the middle

    @cached_property
    def dots(self) -> NDArray[np.float64]:
        """Columns, rows and radii of all dots, (N, 3), radii in mm."""
        side = np.arange(-self.reach, self.reach + 1)
        columns, rows = (each.ravel() for each in np.meshgrid(side, side))
        return np.column_stack([columns, rows, self.radius_mm(columns, rows)])

    def radius_mm(self, columns: NDArray[np.int_], rows: NDArray[np.int_]) -> NDArray[np.float64]:
        """Return the radius of dots."""
        large = np.zeros(np.shape(columns), bool)
        for column, row in LARGE_DOTS:
            large |= (columns == column) & (rows == row)
        return np.where(large, LARGE_SHARE, DOT_SHARE) * self.pitch_mm / 2

    def ink(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether there is ink at places around the middle."""
        columns = np.rint(x_mm / self.pitch_mm).astype(int)
        rows = np.rint(y_mm / self.pitch_mm).astype(int)
        away = np.hypot(x_mm - columns * self.pitch_mm, y_mm - rows * self.pitch_mm)
        there = np.maximum(np.abs(columns), np.abs(rows)) <= self.reach
        return np.asarray((away <= self.radius_mm(columns, rows)) & there)

    def draw(self, path: Path) -> None:
        """Write the target as a PNG file with its resolution."""
        dot_per_mm = PRINT_DPI / _INCH_MM
        middle = round(((self.reach + 0.5) * self.pitch_mm + _MARGIN_MM) * dot_per_mm)
        side = 2 * middle + 1
        image = Image.new("L", (side, side), 255)
        pen = ImageDraw.Draw(image)
        for column, row, radius in self.dots:
            x, y = (middle + each * self.pitch_mm * dot_per_mm for each in (column, row))
            reach = radius * dot_per_mm
            pen.ellipse([x - reach, y - reach, x + reach, y + reach], fill=0)
        text = f"SmartTouch {self.pitch_mm:g} mm: print at 100 %, measure {self._ruler()}"
        size = 2.2 * dot_per_mm
        while pen.textlength(text, font_size=size) > side - 2 * dot_per_mm:
            size *= 0.9
        pen.text((dot_per_mm, dot_per_mm), text, fill=0, font_size=size)
        content = BytesIO()
        image.save(content, format="PNG", dpi=(PRINT_DPI, PRINT_DPI))
        write_bytes(path, content.getvalue(), CalibrationError)

    def _ruler(self) -> str:
        return f"{2 * self.reach * self.pitch_mm:g} mm from first to last dot"


def target_for(profile: Profile, dot_pitch_mm: float | None = None) -> DotTarget:
    """Return the target for a sensor, with about five dots across its field, or of the given
    pitch."""
    optics = profile.optics
    field_mm = min(optics.field_width_mm, optics.field_height_mm)
    pitch_mm = dot_pitch_mm
    if pitch_mm is None:
        finest_mm = FEWEST_PIXELS * max(
            optics.field_width_mm / optics.sensor_columns,
            optics.field_height_mm / optics.sensor_rows,
        )
        fit = [each for each in _PITCHES_MM if finest_mm <= each <= field_mm / FEWEST_PITCHES]
        wished = [each for each in fit if each <= field_mm / _WISHED_PITCHES]
        if not fit:
            raise CalibrationError(
                f"{optics.sensor_columns} × {optics.sensor_rows} pixels over "
                f"{optics.field_width_mm:g} × {optics.field_height_mm:g} mm are too coarse for a "
                "target: set optics.rotation_deg, offset_x_mm and offset_y_mm by hand, or give the "
                "pitch of its dots if the sensor is finer than the profile says"
            )
        pitch_mm = max(wished) if wished else min(fit)
    words = f"a pitch of {pitch_mm:g} mm between dots in a field of {field_mm:g} mm"
    require_within(CalibrationError, "dot_pitch_mm", pitch_mm, _FINEST_MM, field_mm, words)
    longest = max(optics.field_width_mm, optics.field_height_mm) / pitch_mm
    return DotTarget(pitch_mm, min(_MOST_DOTS, math.ceil(0.75 * longest) + _SPARE))


Points = NDArray[np.float64]
Matrix = NDArray[np.floating[Any]]

WORKING_SIDE = 480
"""Pixels of the shorter side at which dots are detected; coarser images are magnified."""
FEWEST_SIDE = 16
LEAST_INK = 0.15  # least contrast of a dot against the paper around it
LARGER = 1.6
"""Least area of a large dot, relative to its neighbors; it was printed 2.8 times as large."""
NEAR = 0.28  # part of the pitch: a dot this close to its expected place is that dot
_MOST_LARGE = 8
_MOST_SHEAR = 2.0  # ratio of the axes of a view; the L seen as its own mirror image would have 2.4


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots found in an image, with their names."""

    pixel: Points  # (N, 2): their centers: column, row; pixel centers are at whole numbers
    cell: NDArray[np.int_]  # (N, 2) int: their columns and rows on the target


def find_dots(image: NDArray[np.uint8]) -> Dots:
    """Find the target's dots in an image."""
    if min(image.shape) < FEWEST_SIDE:
        raise CalibrationError(
            f"an image of {image.shape[1]} × {image.shape[0]} pixels is too coarse for dots: "
            f"{FEWEST_SIDE} a side are needed"
        )
    pixel, area = _blobs(image)
    seed = _find_l(pixel, area)
    return _spread(pixel, seed)


def apply(homography: Matrix, points: Points) -> Points:
    """Return the points, (N, 2), mapped by a homography."""
    carried = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(carried[:, :2] / carried[:, 2:])


def _blobs(image: NDArray[np.uint8]) -> tuple[Points, NDArray[np.float64]]:
    """Return centers and areas of all dark spots that are whole, in pixels of the image."""
    ink, scale = _ink(image)
    if np.percentile(ink, 99.5) < LEAST_INK:
        raise CalibrationError(
            "no dots are seen: lay the printed target under the sensor, and light it"
        )
    grey = np.rint(255 * ink).astype(np.uint8)
    level, binary = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    level = max(level / 255, LEAST_INK)
    count, _, boxes, _ = cv2.connectedComponentsWithStats(binary, connectivity=4)
    rows, columns = ink.shape
    centers, areas = [], []
    for left, top, width, height, area in boxes[1:count]:
        whole = left > 1 and top > 1 and left + width < columns - 1 and top + height < rows - 1
        filled = area > 0.55 * width * height and max(width, height) < 2.5 * min(width, height)
        if not (whole and filled and area >= 9):
            continue
        edge = round(0.15 * max(width, height)) + 1
        part = (
            slice(max(0, top - edge), top + height + edge),
            slice(max(0, left - edge), left + width + edge),
        )
        # Grey counts, above half of where the dot begins: steady to a small part of a pixel.
        weight = np.clip(ink[part] - level / 2, 0, None)
        y, x = np.indices(weight.shape)
        total = weight.sum()
        centers.append(
            (
                part[1].start + float((weight * x).sum() / total),
                part[0].start + float((weight * y).sum() / total),
            )
        )
        areas.append(float(area) / scale**2)
    middle = np.array(centers, np.float64).reshape(-1, 2)
    return (middle + 0.5) / scale - 0.5, np.array(areas)


def _ink(image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], float]:
    """Return the contrast of each place against the paper around it, and the magnification."""
    scale = WORKING_SIDE / min(image.shape)
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    working = cv2.resize(image.astype(np.float32), size, interpolation=method)
    working = cv2.GaussianBlur(working, (0, 0), max(1.5, 0.3 * scale))
    # Paper is what is left when all that is dark and smaller than this is filled with light.
    side = WORKING_SIDE // 5 | 1
    square = cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))
    paper = cv2.morphologyEx(working, cv2.MORPH_CLOSE, square, borderType=cv2.BORDER_REPLICATE)
    paper = cv2.GaussianBlur(paper, (0, 0), side / 4)
    ink = 1 - working / np.maximum(paper, 1)
    return np.clip(ink, 0, 1).astype(np.float32), scale


def _find_l(pixel: Points, area: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the affine map, (2, 3), from columns and rows to pixels, by the large dots."""
    if len(pixel) < 9:
        raise CalibrationError(
            f"only {len(pixel)} whole dots are seen, 9 are needed: bring the target into view and "
            "into focus"
        )
    apart = np.linalg.norm(pixel[:, None] - pixel[None], axis=2)
    around = np.argsort(apart, axis=1)[:, 1:9]
    # The lower third: among the neighbors of a large dot, most others may be large themselves.
    usual = np.sort(area[around], axis=1)[:, 2]
    ratio = area / usual
    large = np.flatnonzero(ratio > LARGER)
    large = large[np.argsort(-ratio[large])][:_MOST_LARGE]
    best: tuple[float, NDArray[np.float64]] | None = None
    grid = np.column_stack([np.array(LARGE_DOTS, np.float64), np.ones(4)])
    inverse = np.linalg.pinv(grid)
    for chosen in itertools.permutations(large, 4):
        seen = pixel[list(chosen)]
        affine = (inverse @ seen).T
        axes = np.linalg.svd(affine[:, :2], compute_uv=False)
        if axes[1] <= 0 or axes[0] > _MOST_SHEAR * axes[1]:
            continue
        away = float(np.abs(grid @ affine.T - seen).max()) / float(axes[1])
        if away < NEAR / 2 and (best is None or away < best[0]):
            best = (away, affine)
    if best is None:
        raise CalibrationError(
            f"the L of four large dots is not seen among {len(pixel)} dots: move the target until "
            "it is in the middle of the image, and in focus"
        )
    return best[1]


def _spread(pixel: Points, affine: NDArray[np.float64]) -> Dots:
    """Name dot after dot, outwards from the L."""
    to_pixel = np.vstack([affine, [0, 0, 1]])
    named: dict[int, tuple[int, int]] = {}
    reach = 2
    while True:
        guess = apply(np.linalg.inv(to_pixel), pixel)
        cell = np.rint(guess).astype(int)
        near = (np.abs(guess - cell).max(axis=1) < NEAR) & (np.abs(cell).max(axis=1) <= reach)
        fresh = {int(i): (int(cell[i, 0]), int(cell[i, 1])) for i in np.flatnonzero(near)}
        fresh = _unique(fresh, guess)
        if len(fresh) <= len(named) and reach > np.abs(guess).max():
            break
        named = fresh
        if len(named) >= 9:
            cells = np.array(list(named.values()), np.float64)
            fitted, _ = cv2.findHomography(cells, pixel[list(named)], 0)
            if fitted is not None:
                to_pixel = np.asarray(fitted, np.float64)
        reach += 1
        if reach > 100:
            break
    return Dots(pixel[list(named)], np.array(list(named.values()), int).reshape(-1, 2))


def _unique(named: dict[int, tuple[int, int]], guess: Points) -> dict[int, tuple[int, int]]:
    """Keep the nearest of the dots that fall into one cell: the others are dirt."""
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for index, cell in named.items():
        away = float(np.abs(guess[index] - cell).max())
        if cell not in best or away < best[cell][0]:
            best[cell] = (away, index)
    return {index: cell for cell, (_, index) in best.items()}
