"""Heights of images and texts, and the pitch that dominates them."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError
from smarttouch.pages.page_image import (
    check_scale_options,
    open_image,
    read_grey,
    require_size_mm,
)
from smarttouch.pages.prepared_page import print_text

_SIDE = 512  # pixels of the image for the spectrum
_FEWEST_CYCLES = 5.0
"""Fewest periods across the shorter side; with fewer it is a shape and no texture."""
_PROMINENT = 0.25
"""Share of the variance, but for that of the light, that a single one must carry to dominate: three
directions at one pitch, as of a honeycomb, have a third each. An estimate of ours."""
_LIGHT_CYCLES = 2.5  # cycles across the longer side below which changes are of the light
_COARSEST_MM = 10.0  # coarsest pitch of a texture; beyond, ridges are felt one by one
_AROUND = 2  # bins of a peak on each side: the main lobe of a Hann window


def dominant_pitch_mm(height: NDArray[np.float32], mm_per_pixel: float) -> float | None:
    """Return the pitch that dominates a relief, (H, W), mm; None if none does.

    By Welch's windowed periodogram (1967), in two dimensions: a pitch dominates if the main lobe of
    one spatial frequency, and of its mirror image, carry at least a quarter of the variance.
    """
    shrink = min(1.0, _SIDE / max(height.shape))
    if shrink < 1:
        size = [max(2, round(side * shrink)) for side in height.shape[::-1]]
        height = np.asarray(cv2.resize(height, size, interpolation=cv2.INTER_AREA), np.float32)
        mm_per_pixel /= shrink
    rows, columns = height.shape
    window = np.hanning(rows)[:, None] * np.hanning(columns)
    mean = float((height * window).sum() / max(window.sum(), 1e-12))
    power = np.fft.fftshift(np.abs(np.fft.fft2((height - mean) * window, (_SIDE, _SIDE))) ** 2)
    cycles = np.fft.fftshift(np.fft.fftfreq(_SIDE))
    by_y, by_x = np.meshgrid(cycles, cycles, indexing="ij")
    frequency = np.hypot(by_x, by_y)
    searched = np.where(frequency * min(rows, columns) >= _FEWEST_CYCLES, power, 0.0)
    row, column = divmod(int(searched.argmax()), _SIDE)
    # Padding has widened the lobe.
    lobe = np.hypot((by_x - by_x[row, column]) * columns, (by_y - by_y[row, column]) * rows)
    own = power * (lobe <= _AROUND)
    # Uneven light is not counted, however strong it is.
    total = float(power[frequency * max(rows, columns) >= _LIGHT_CYCLES].sum())
    if not total or 2 * float(own.sum()) < _PROMINENT * total:
        return None
    pitch_mm = mm_per_pixel * float(own.sum()) / float((own * frequency).sum())
    return pitch_mm if pitch_mm <= _COARSEST_MM else None


LETTER_MM = 12.0  # height of printed letters: wide enough strokes for electrodes 2 mm apart
_PRINTED_MM = 4.2  # height of the letters of `print_text`, ascender to descender
_MARGIN_MM = 4.0
_SCALE = "dpi or width_mm"
_LEAST_RANGE = 7.65  # least range of grey levels; with less, nothing is shown


class Heights(NamedTuple):
    """Heights of a relief before its grain is known."""

    title: str
    height: NDArray[np.float32]  # (H, W) in [0, 1]
    mm_per_pixel: float
    photo: bool = True  # whether it may show a texture that has a pitch; print has none


def load_heights(path: Path, dpi: float | None = None, width_mm: float | None = None) -> Heights:
    """Load an image, whose ink is high; the scale is needed where the file has none."""
    check_scale_options(dpi, width_mm, "width_mm")
    with open_image(path) as image:
        grey, mm_per_pixel = read_grey(path, image, dpi, width_mm)
    if mm_per_pixel is None:
        raise PageError(f"{path} does not say how large it is: give {_SCALE}")
    rows, columns = grey.shape
    require_size_mm(str(path), columns * mm_per_pixel, rows * mm_per_pixel, _SCALE)
    return Heights(path.name, _stretched(path.name, 255 - grey.astype(np.float64)), mm_per_pixel)


def print_heights(text: str, width_mm: float | None = None) -> Heights:
    """Print a text in large letters, 12 mm high unless the width of the whole is given."""
    check_scale_options(None, width_mm, "width_mm")
    page = print_text(text)
    mm_per_pixel = page.mm_per_pixel * LETTER_MM / _PRINTED_MM
    ink = page.grey < 128
    rows, columns = (np.flatnonzero(ink.any(axis=axis)) for axis in (1, 0))
    grey = page.grey[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    grey = np.asarray(np.pad(grey, round(_MARGIN_MM / mm_per_pixel), constant_values=255))
    if width_mm is not None:
        mm_per_pixel = width_mm / grey.shape[1]
    require_size_mm(
        "the text", grey.shape[1] * mm_per_pixel, grey.shape[0] * mm_per_pixel, "width_mm"
    )
    return Heights(f"“{text}”", np.asarray(1 - grey / 255, np.float32), mm_per_pixel, photo=False)


def _stretched(name: str, values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return values stretched to 0 to 1, without the few outliers."""
    low, high = np.percentile(values, (0.5, 99.5))
    if high - low <= _LEAST_RANGE:
        low, high = values.min(), values.max()
    if high - low <= _LEAST_RANGE:
        message = f"{name} is flat: there is nothing on it that could be felt"
        raise PageError(message)
    return np.asarray(np.clip((values - low) / (high - low), 0, 1), np.float32)
