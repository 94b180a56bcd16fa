"""A photograph of embossed Braille, from a height map and a lamp at its side."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.pages.page_image import Page

PAPER_BEND_MM = 0.12
"""Paper does not fold sharply where a dot begins."""
PAPER_GREY = 205.0
MARGIN_MM = 16.0


@dataclass(frozen=True, eq=False)
class Embossed:
    """A rendered photograph, the (N, 2) px where the dots of its front are, and its cells."""

    page: Page
    dots_px: NDArray[np.float64]
    cells_px: NDArray[np.float64]  # (M, 2), middles
    patterns: NDArray[np.int_]  # (M,), bit k is dot k + 1


def emboss(
    lines: list[str],
    *,
    px_per_mm: float = 8.0,
    light_deg: float = 120.0,
    skew_deg: float = 0.0,
    blur_px: float = 0.5,
    noise: float = 1.5,
    shading: float = 0.0,
    texture: float = 1.0,
    perspective: float = 0.0,
    curl_mm: float = 0.0,
    back_side: list[str] | None = None,
    back_shift: tuple[float, float] = (0.5, 0.5),
    dent: float = 0.8,
    dot_mm: float = 2.34,
    cell_mm: float = 6.2,
    line_mm: float = 10.0,
    uneven: float = 0.08,
    lost: float = 0.0,
    quality: int = 88,
    height_mm: float = 0.48,
    radius_mm: float = 0.75,
    elevation_deg: float = 22.0,
    ambient: float = 0.35,
    seed: int = 0,
) -> Embossed:
    """Render lines of cells as they look in a photograph.

    Light comes from the right at 0°, from the top at 90; ``shading`` is the part of it that the
    darkest corner lacks. ``noise`` is in grey levels, ``texture`` the roughness of ordinary
    Braille paper, ``perspective`` how much smaller the far edge is, ``dent`` the depth of a dot
    seen from behind, of its height, ``back_shift`` how far the dots of the back are to the right of
    and below those of the front, in distances of dots, ``uneven`` the spread of heights, and half
    of it, in mm, that of places; ``lost`` is the share of dots that are worn flat. Each line is
    bent by ``curl_mm``.
    Height and radius of dots are those of NLS 800; ``ambient`` is the part of the light that comes
    from everywhere, the rest from a lamp at ``elevation_deg``.
    """
    rng = np.random.default_rng(seed)
    columns = max(len(line) for line in (*lines, *(back_side or [])))
    rows = max(len(lines), len(back_side or []))
    size_mm = np.array(
        [(columns - 1) * cell_mm + dot_mm, (rows - 1) * line_mm + 2 * dot_mm]
    ) + 2 * MARGIN_MM  # fmt: skip
    to_px, size_px = _camera(size_mm, px_per_mm, skew_deg, perspective, curl_mm)
    front_mm = _dots_mm(lines, dot_mm, cell_mm, line_mm) + MARGIN_MM
    front_mm = front_mm[rng.random(len(front_mm)) >= lost]
    front_mm += rng.normal(0, 0.5 * uneven, front_mm.shape)
    front_px = to_px(front_mm)
    height_px = np.zeros(size_px[::-1], np.float32)
    sphere_px = radius_mm * px_per_mm, height_mm * px_per_mm
    _stamp(height_px, front_px, sphere_px, rng.normal(1, uneven, len(front_px)))
    if back_side is not None:
        back_mm = _dots_mm(back_side, dot_mm, cell_mm, line_mm) + MARGIN_MM
        back_mm[:, 0] = size_mm[0] - back_mm[:, 0]
        back_mm += dot_mm * np.array(back_shift)
        _stamp(height_px, to_px(back_mm), sphere_px, -dent * rng.normal(1, uneven, len(back_mm)))
    height_px = cv2.GaussianBlur(height_px, (0, 0), PAPER_BEND_MM * px_per_mm)
    height_px += _fibers(height_px.shape, px_per_mm, texture, rng)
    light = _lit(height_px, math.radians(light_deg), math.radians(elevation_deg), ambient)
    light *= _falloff(light.shape, shading, math.radians(light_deg))
    speckle = rng.standard_normal(light.shape, np.float32)
    light *= 1 + 0.012 * texture * cv2.GaussianBlur(speckle, (0, 0), 0.15 * px_per_mm)
    grey = PAPER_GREY * light
    if blur_px:
        grey = cv2.GaussianBlur(grey, (0, 0), blur_px)
    grey += noise * rng.standard_normal(grey.shape, np.float32)
    picture = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    _, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    picture = np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), np.uint8)
    # The photograph does not know its scale: any number will do.
    cells_mm, patterns = _cells_mm(lines, dot_mm, cell_mm, line_mm)
    return Embossed(Page(picture, 0.1), front_px, to_px(cells_mm + MARGIN_MM), patterns)


def printed(embossed: Embossed, radius_px: float, light_on_dark: bool = False) -> Page:
    """Draw the dots as discs of ink where they would have been embossed."""
    ink = np.zeros(embossed.page.grey.shape, np.uint8)
    for x, y in np.rint(embossed.dots_px * 16).astype(int):
        cv2.circle(ink, (int(x), int(y)), round(radius_px * 16), 255, -1, cv2.LINE_AA, 4)
    grey = cv2.GaussianBlur(225 - (ink * 0.75).astype(np.uint8), (0, 0), 0.7)
    return Page(255 - grey if light_on_dark else grey, 0.1)


def random_lines(rows, columns, seed, blank=0.15, density=0.45):
    """Return lines of random cells, none of them with a blank end."""
    rng = np.random.default_rng(seed)
    dots = rng.random((rows, columns, 6)) < density
    dots[~dots.any(axis=2), 0] = True
    dots[rng.random((rows, columns)) < blank] = False
    dots[:, -1, 0] = True
    codes = 0x2800 + dots @ (1 << np.arange(6))
    return ["".join(map(chr, line)) for line in codes.tolist()]


def _dots_mm(lines, dot_mm, cell_mm, line_mm):
    """Return where dots are, (N, 2) mm from the first dot of the first cell."""
    places = [
        (column * cell_mm + (dot // 3) * dot_mm, row * line_mm + (dot % 3) * dot_mm)
        for row, line in enumerate(lines)
        for column, cell in enumerate(line)
        for dot in range(6)
        if (ord(cell) - 0x2800) >> dot & 1
    ]
    return np.array(places, np.float64).reshape(-1, 2)


def _cells_mm(lines, dot_mm, cell_mm, line_mm):
    """Return the middles of cells, (M, 2) mm from the first dot of the first, and patterns."""
    cells = [
        (column * cell_mm + dot_mm / 2, row * line_mm + dot_mm, ord(cell) - 0x2800)
        for row, line in enumerate(lines)
        for column, cell in enumerate(line)
        if cell != "\u2800"
    ]
    every = np.array(cells, np.float64).reshape(-1, 3)
    return every[:, :2], every[:, 2].astype(int)


def _camera(size_mm, px_per_mm, skew_deg, perspective, curl_mm):
    """Return the map from the page to the picture, and the picture's size, px."""
    cos, sin = math.cos(math.radians(skew_deg)), math.sin(math.radians(skew_deg))

    def to_px(place_mm):
        x, y = (place_mm - size_mm / 2).T
        y = y + curl_mm * ((2 * x / size_mm[0]) ** 2 - 1)
        x, y = cos * x + sin * y, cos * y - sin * x
        # The page leans away from the camera to the top right.
        away = 1 + perspective * (0.4 * x / size_mm[0] - 0.9 * y / size_mm[1])
        return np.column_stack([x / away, y / away]) * px_per_mm + middle_px

    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * size_mm
    middle_px = np.zeros(2)
    reach = np.abs(to_px(corners)).max(axis=0)
    middle_px = reach
    width, height = np.ceil(2 * reach).astype(int).tolist()
    return to_px, (width, height)


def _stamp(height_px, dots_px, sphere_px, raised):
    """Raise caps of spheres from the paper by so much of their height, or sink them into it."""
    radius, top = sphere_px
    sphere = (radius**2 + top**2) / (2 * top)
    reach = math.ceil(radius) + 1
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    for (x, y), way in zip(dots_px, raised, strict=True):
        column, row = round(x), round(y)
        away = (columns + column - x) ** 2 + (rows + row - y) ** 2
        cap = np.sqrt(np.maximum(sphere**2 - away, 0)) - (sphere - top)
        height_px[row - reach : row + reach + 1, column - reach : column + reach + 1] += (
            way * np.maximum(cap, 0)
        )


def _fibers(shape, px_per_mm, texture, rng):
    """Return the relief of paper: fibers in many directions, and slow waves, in pixels."""
    relief = np.zeros(shape, np.float32)
    for angle in range(0, 180, 45):
        length = math.ceil(0.8 * px_per_mm) | 1
        line = np.zeros((length, length), np.float32)
        step = np.array([math.cos(math.radians(angle)), math.sin(math.radians(angle))])
        ends = length // 2 + np.outer([-1, 1], step * (length // 2))
        first, last = np.rint(ends).astype(int).tolist()
        cv2.line(line, first, last, 1.0)
        relief += cv2.filter2D(rng.standard_normal(shape, np.float32), -1, line / line.sum())
    relief *= 0.006 * px_per_mm * texture / relief.std()
    coarse = rng.standard_normal((max(2, shape[0] // 64), max(2, shape[1] // 64)), np.float32)
    waves = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return relief + 0.05 * px_per_mm * texture * waves


def _lit(height_px, azimuth, elevation, ambient):
    """Return the light that paper (Lambert's) sends back, 1 where it is flat."""
    toward = np.array([math.cos(azimuth), -math.sin(azimuth)])
    slope_y, slope_x = np.gradient(height_px)
    facing = math.sin(elevation) - math.cos(elevation) * (slope_x * toward[0] + slope_y * toward[1])
    facing /= np.sqrt(1 + slope_x**2 + slope_y**2)
    direct = np.maximum(facing, 0) / math.sin(elevation)
    # What rises between a place and the lamp, above the ray: the lamp is a few degrees wide.
    rise, wide = math.tan(elevation), 0.25
    above = np.full_like(height_px, -np.inf)
    farthest = math.ceil(float(np.ptp(height_px)) / rise)
    size = height_px.shape[::-1]
    for step in range(1, farthest + 1):
        shift = np.array([[1, 0, step * toward[0]], [0, 1, step * toward[1]]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        there = cv2.warpAffine(height_px, shift, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        np.maximum(above, (there - height_px) / (rise * step) - 1, out=above)
    shadow = np.clip(0.5 + above / wide, 0, 1)
    return np.asarray(ambient + (1 - ambient) * direct * (1 - shadow), np.float32)


def _falloff(shape, shading, azimuth):
    """Return uneven light: a lamp that is near, and a lens that darkens the corners."""
    y, x = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j].astype(np.float32)
    toward = x * math.cos(azimuth) - y * math.sin(azimuth)
    lamp = 1 - shading * (0.5 - 0.5 * toward / math.sqrt(2))
    return np.asarray(lamp * (1 - 0.15 * shading * (x * x + y * y)), np.float32)
