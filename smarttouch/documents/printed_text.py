"""Pages printed from a text."""

import textwrap

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from smarttouch.documents.page_image import INCH_MM, LARGEST_MM, Page
from smarttouch.documents.prepare import PreparedPage
from smarttouch.documents.text_lines import TextLine
from smarttouch.errors import PageError

PRINT_DPI = 300
_PRINT_WIDTH_MM = 92.0
_MARGIN_MM = 7.0
_LINE_MM = 4.2  # height of a line, ascender to descender
_LINE_STEP_MM = 8.0
_COLUMNS = 30
_INK_LEVEL = 15
_PER_MM = PRINT_DPI / INCH_MM
_SIZE_PX = _LINE_MM * _PER_MM * 1.26


def print_text(text: str) -> Page:
    """Print a text as black on white at 300 dots per inch."""
    lines = _wrapped(text)
    height_mm = 2 * _MARGIN_MM + (len(lines) - 1) * _LINE_STEP_MM + _LINE_MM
    if height_mm > LARGEST_MM:
        raise PageError(
            f"the text has {len(lines)} lines, a page of {height_mm:.0f} mm, above the "
            f"{LARGEST_MM:g} that are possible: shorten it",
            about="text",
        )
    size = (round(_PRINT_WIDTH_MM * _PER_MM), round(height_mm * _PER_MM))
    sheet = Image.new("L", size, 255)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=_SIZE_PX)
    for index, line in enumerate(lines):
        draw.text((_MARGIN_MM * _PER_MM, _top_px(index)), line, fill=_INK_LEVEL, font=font)
    return Page(np.asarray(sheet), 1 / _PER_MM)


def prepare_text(text: str) -> PreparedPage:
    """Print a text and return it ready to be read, with its known lines."""
    page, font = print_text(text), ImageFont.load_default(size=_SIZE_PX)
    # Boxes from the baseline.
    high, low, x_high = (font.getbbox(letters, anchor="ls") for letters in ("dlA", "gpy", "x"))
    below_top_px = font.getbbox("x", anchor="la")[1] - x_high[1]
    lines = []
    for index, line in enumerate(_wrapped(text)):
        if line.strip():
            left, _, right, _ = font.getbbox(line)
            lines.append(
                TextLine(
                    left_mm=_MARGIN_MM + left / _PER_MM,
                    right_mm=_MARGIN_MM + right / _PER_MM,
                    baseline=((_top_px(index) + below_top_px) / _PER_MM,),
                    x_height_mm=-x_high[1] / _PER_MM,
                    ascent_mm=-high[1] / _PER_MM,
                    descent_mm=low[3] / _PER_MM,
                )
            )
    return PreparedPage(page, page.grey, tuple(lines), light_on_dark=False, notes=())


def _wrapped(text: str) -> list[str]:
    lines = [line for part in text.splitlines() for line in textwrap.wrap(part, _COLUMNS) or [""]]
    if not any(line.strip() for line in lines):
        raise PageError("text: has nothing to print: give some words after the colon", about="text")
    return lines


def _top_px(index: int) -> float:
    return (_MARGIN_MM + index * _LINE_STEP_MM) * _PER_MM
