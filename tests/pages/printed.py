"""Test pages with known lines and baselines, and simulated scans and photographs of them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from smarttouch.pages.page_and_lines import Page

INCH_MM = 25.4
MARGIN_MM = 15.0
GUTTER_MM = 8.0
LEADING = 1.25
"""Distance of baselines, relative to the font size."""
PAPER, INK = 235, 25
TABLE = 50
"""Grey level of the table under a photographed sheet."""

_PROSE = """
the quick brown fox jumps over a lazy dog while pale light falls on every page that hands have
touched Some quiet people joke about vexing Quartz and happily pay for it in May 1947, or (perhaps)
by 26 June; yet nobody knew what Gypsy kings of old would buy
"""
WORDS = _PROSE.split()


@dataclass(frozen=True, eq=False)
class PrintedLine:
    """Text of a printed line, and its baseline: (N, 2) points from the first letter to the last."""

    text: str
    baseline_mm: np.ndarray
    x_height_mm: float


@dataclass(frozen=True, eq=False)
class Printed:
    """A page image and its printed lines in reading order."""

    page: Page
    lines: tuple[PrintedLine, ...]


def print_page(
    lines: list[str],
    *,
    size_pt: float,
    dpi: int = 300,
    font: str = "DejaVuSerif",
    columns: int = 1,
    heading: str | None = None,
) -> Printed:
    """Draw lines of text in columns, below an optional heading of 1.8 times the font size."""
    per_mm = dpi / INCH_MM
    letters = _font(font, size_pt * dpi / 72)
    large = _font(font, 1.8 * size_pt * dpi / 72)
    step = LEADING * size_pt * dpi / 72
    rows = -(-len(lines) // columns)
    column_px = max(letters.getlength(line) for line in lines)
    text_px = columns * column_px + (columns - 1) * GUTTER_MM * per_mm
    if heading:
        text_px = max(text_px, large.getlength(heading))
    first = MARGIN_MM * per_mm + step + (2.4 * step if heading else 0)
    width = round(text_px + 2 * MARGIN_MM * per_mm)
    height = round(first + rows * step + MARGIN_MM * per_mm)
    sheet = Image.new("L", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    printed = []

    def put(text: str, x: float, y: float, face: ImageFont.FreeTypeFont) -> None:
        x, y = round(x), round(y)
        draw.text((x, y), text, fill=INK, font=face, anchor="ls")
        left, _, right, _ = face.getbbox(text, anchor="ls")
        along = np.linspace(x + left, x + right, 25)
        points = np.column_stack([along, np.full(len(along), float(y))]) / per_mm
        top = face.getbbox("x", anchor="ls")[1]
        printed.append(PrintedLine(text, points, -top / per_mm))

    if heading:
        put(heading, MARGIN_MM * per_mm, MARGIN_MM * per_mm + 1.4 * step, large)
    for index, text in enumerate(lines):
        column, row = divmod(index, rows)
        x = MARGIN_MM * per_mm + column * (column_px + GUTTER_MM * per_mm)
        put(text, x, first + row * step, letters)
    return Printed(Page(np.asarray(sheet), 1 / per_mm), tuple(printed))


def some_lines(count: int, width: int = 60, seed: int = 0) -> list[str]:
    """Return lines of random words, up to ``width`` characters; every seventh line is short."""
    random = np.random.default_rng(seed)
    lines = []
    for index in range(count):
        goal = width * (0.35 if index % 7 == 6 else 1)
        line = str(random.choice(WORDS))
        while len(longer := f"{line} {random.choice(WORDS)}") <= goal:
            line = longer
        lines.append(line)
    return lines


def degrade(
    printed: Printed,
    *,
    skew_deg: float = 0,
    uneven: float = 0,
    noise: float = 0,
    blur_px: float = 0,
    perspective: float = 0,
    curvature: float = 0,
    inverted: bool = False,
    jpeg: int | None = None,
    seed: int = 0,
) -> Printed:
    """Simulate a bad scan or a photograph of a page. Its baselines are transformed with the image.

    ``skew_deg`` rotates clockwise. ``uneven``, 0 to 1, is the strength of three effects: brightness
    that falls across the page, dark corners and a shadow. ``noise`` is a standard deviation in grey
    levels. ``perspective`` puts the sheet on a dark table; it is the fraction by which the far edge
    is narrower. ``curvature`` is the bend of the lowest line in mm, as in an open book; the top
    line bends by a third of that. ``jpeg`` is the quality of compression.
    """
    grey = printed.page.grey
    if inverted:
        grey = 255 - grey
    paper = int(np.median(grey))
    scale = printed.page.mm_per_pixel
    moves: list[Callable[[np.ndarray], np.ndarray]] = []
    if curvature:
        grey, move = _bent(grey, curvature / scale, paper)
        moves.append(move)
    if perspective:
        grey, move = _laid_on_a_table(grey, perspective)
        moves.append(move)
    if skew_deg:
        grey, move = _turned(grey, skew_deg, TABLE if perspective else paper)
        moves.append(move)
    lines = []
    for line in printed.lines:
        points = line.baseline_mm / scale
        for move in moves:
            points = move(points)
        lines.append(PrintedLine(line.text, points * scale, line.x_height_mm))
    image = grey.astype(np.float32)
    if blur_px:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    if uneven:
        image *= _light(image.shape, uneven)
    if noise:
        image += np.random.default_rng(seed).normal(0, noise, image.shape).astype(np.float32)
    grey = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    if jpeg is not None:
        _, packed = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, jpeg])
        grey = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
    return Printed(Page(np.asarray(grey), scale), tuple(lines))


PAPERS = ("white", "grey", "gradient", "grain", "lined", "squared", "stained", "table", "shadow",
          "show-through")  # fmt: skip
"""Names of the unprinted sheets of `blank_papers`."""


@cache
def blank_papers():
    """Return a grey image of an unprinted sheet for each name in `PAPERS`."""
    random = np.random.default_rng(5)
    y, x = np.mgrid[:600, :800].astype(np.float32)
    white = np.full((600, 800), 250, np.float32)
    kinds = {"white": white, "grey": white - 100, "gradient": white - 0.15 * x}
    kinds["grain"] = white - 30 + random.normal(0, 9, white.shape)
    kinds["lined"] = np.where(y % 50 < 3, 0.93, 1) * 240
    kinds["squared"] = np.where((y % 30 < 2) | (x % 30 < 2), 0.93, 1) * 240
    stain = np.hypot(x - 400, y - 300)
    kinds["stained"] = 240 - 35 / (1 + np.exp((stain - 150) / 15))
    kinds["table"] = np.where(x > 90, 230.0, 60.0)
    kinds["shadow"] = 235 * (1 - 0.4 / (1 + np.exp((x - 0.4 * y - 300) / 12)))
    text = print_page(some_lines(14, 40), size_pt=11, dpi=150).page.grey[:600, :800]
    back = np.full((600, 800), 235, np.float32)
    back[: text.shape[0], : text.shape[1]] = text[:, ::-1]
    kinds["show-through"] = 235 - 0.08 * cv2.GaussianBlur(235 - back, (0, 0), 2)
    return {
        name: np.clip(paper + random.normal(0, 2, paper.shape), 0, 255).astype(np.uint8)
        for name, paper in kinds.items()
    }


def _font(name: str, size_px: float) -> ImageFont.FreeTypeFont:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / f"{name}.ttf"), size_px)


def _bent(grey, most_px, paper):
    """Return an image bent like a page bound at its left, and a function that bends points."""
    height, width = grey.shape

    def fall(x):
        return most_px * (np.exp(-4 * x / width) - 0.25 * np.sin(np.pi * x / width))

    def forth(points):
        x, y = points.T
        return np.column_stack([x, y + fall(x) * (1 / 3 + 2 / 3 * y / height)])

    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    source = (y - fall(x) / 3) / (1 + fall(x) * 2 / 3 / height)
    edge = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": paper}
    return cv2.remap(grey, x, source.astype(np.float32), cv2.INTER_CUBIC, **edge), forth


def _laid_on_a_table(grey, narrower):
    height, width = grey.shape
    edge = 0.08 * width
    wide, high = round(width + 2 * edge), round(height + 2 * edge)
    inset = narrower * width / 2
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    seen = corners + edge
    seen[0] += (inset, inset / 2)
    seen[1] += (-inset, inset / 3)
    matrix = cv2.getPerspectiveTransform(corners, seen.astype(np.float32))
    laid = cv2.warpPerspective(grey, matrix, (wide, high), flags=cv2.INTER_CUBIC, borderValue=TABLE)
    return laid, lambda points: _carried(matrix, points)


def _turned(grey, degrees, border):
    height, width = grey.shape
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), -degrees, 1)
    turned = cv2.warpAffine(
        grey, matrix, (width, height), flags=cv2.INTER_CUBIC, borderValue=border
    )
    return turned, lambda points: _carried(np.vstack([matrix, [0, 0, 1]]), points)


def _carried(matrix, points):
    carried = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return carried[:, :2] / carried[:, 2:]


def _light(shape, uneven):
    """Return the relative brightness of each pixel: a slope, dark corners, a soft-edged shadow."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    slope = 1 - uneven * 0.4 * (x + 1) / 2
    corners = 1 - uneven * 0.15 * (x * x + y * y)
    shadow = 1 - uneven * 0.35 / (1 + np.exp((0.3 * x - y + 0.4) / 0.03))
    return (slope * corners * shadow).astype(np.float32)
