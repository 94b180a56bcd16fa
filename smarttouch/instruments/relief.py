"""Reliefs: textures from images and texts, and the pulses of electrodes that move over them.

An electrode pulses **once for each grain (`grain_mm`) of motion over a raised area**. A ridge
narrower than a grain causes one pulse, like a ridge of a grating. A place is raised if it is higher
than the mean of its surroundings. The depth of a place is its distance to the edge of the raised
area, at most half a grain. The first pulse comes at a maximum of depth along the path: in the
middle of a narrow ridge, or half a grain inside a wide area.
"""

import math
import re
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, require_within
from smarttouch.base.urls import all_options
from smarttouch.instruments.textures import (
    COARSEST_PITCH_MM,
    FINEST_PITCH_MM,
    Grating,
    RidgeCrossing,
    Texture,
    TextureSampler,
)
from smarttouch.pages.document import Document
from smarttouch.pages.page_and_lines import require_size_mm
from smarttouch.pages.prepared_page import print_text

LETTER_MM = 12.0  # height of letters; their strokes are then wide enough for electrodes 2 mm apart
_PRINTED_MM = 4.2  # height of the letters that `print_text` draws, ascender to descender
_MARGIN_MM = 4.0
_LEAST_RANGE = 7.65  # an image is flat if its gray levels (0 to 255) differ by at most this


class Heights(NamedTuple):
    """Height map from which a relief is made."""

    title: str
    height: NDArray[np.float32]  # (H, W) in [0, 1]
    mm_per_pixel: float


def load_heights(path: Path, dpi: float | None = None, width_mm: float | None = None) -> Heights:
    """Load an image; dark places are high. A file without scale needs ``dpi`` or ``width_mm``."""
    with Document(path, dpi=dpi, page_width_mm=width_mm) as document:
        page = document.page(0)
    if document.notes:
        raise PageError(f"{path} does not state its size: give dpi or width_mm")
    return Heights(
        path.name, _stretched(path.name, 255 - page.grey.astype(np.float64)), page.mm_per_pixel
    )


def print_heights(text: str, width_mm: float | None = None) -> Heights:
    """Return the height map of a text in letters 12 mm high, or scaled to ``width_mm``."""
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
    return Heights(f"“{text}”", np.asarray(1 - grey / 255, np.float32), mm_per_pixel)


def _stretched(name: str, values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Scale values to the range 0 to 1, and clip the lowest and the highest 0.5 %."""
    low, high = np.percentile(values, (0.5, 99.5))
    if high - low <= _LEAST_RANGE:
        low, high = values.min(), values.max()
    if high - low <= _LEAST_RANGE:
        message = f"{name} is flat, nothing could be felt: choose an image with more contrast"
        raise PageError(message)
    return np.asarray(np.clip((values - low) / (high - low), 0, 1), np.float32)


GRAIN_MM = 2.0  # default distance between pulses: the pitch of the paper's electrodes
_PER_GRAIN = 20  # pixels of the map per grain
_FINEST_MM, _COARSEST_MM = 0.02, 0.1
_MOST_PIXELS = 16_000_000
_LONGEST_SIDE = 32_000  # longest side of a map, px: OpenCV samples with 16-bit coordinates
_LOWEST, _HIGHEST = 0.25, 0.75
"""A place below `_LOWEST` is never raised, and a place above `_HIGHEST` is always raised. Between
these heights, the threshold is the mean height of the surroundings."""
_AROUND = 2.5  # side of the box filter, in grains; two passes have a sigma of one grain together
_BLUR_MM = 0.2  # sigma of the blur that removes noise of photographs; lines 0.1 mm wide survive it


class Relief(Texture):
    """Texture with a height map, and the depth of each place within a raised area.

    `height` is (H, W) in [0, 1]. `depth`, (H, W) mm, is the distance to the edge of the raised
    area, at most half of `grain_mm`. `pixel_mm` is the pixel size of both maps.
    """

    def __init__(
        self,
        heights: Heights,  # height map
        grain_mm: float = GRAIN_MM,  # distance between two pulses on a wide raised area
        inverted: bool = False,  # whether to exchange high and low
    ) -> None:
        rows, columns = heights.height.shape
        wide_mm, high_mm = columns * heights.mm_per_pixel, rows * heights.mm_per_pixel
        super().__init__(heights.title, (wide_mm, high_mm), (wide_mm / 2, high_mm / 2))
        height = 1 - heights.height if inverted else heights.height
        words = f"a grain of {grain_mm:g} mm"
        require_within(PageError, "grain_mm", grain_mm, FINEST_PITCH_MM, COARSEST_PITCH_MM, words)
        self.grain_mm = grain_mm
        pixel_mm = min(max(grain_mm / _PER_GRAIN, _FINEST_MM), _COARSEST_MM)
        pixel_mm = max(
            pixel_mm,
            math.sqrt(wide_mm * high_mm / _MOST_PIXELS),
            max(wide_mm, high_mm) / _LONGEST_SIDE,
        )
        size = (max(2, round(wide_mm / pixel_mm)), max(2, round(high_mm / pixel_mm)))
        self.scale_mm: tuple[float, float] = (wide_mm / size[0], high_mm / size[1])
        self.pixel_mm: float = max(self.scale_mm)
        method = cv2.INTER_AREA if size[0] <= columns else cv2.INTER_LINEAR
        self.height: NDArray[np.float32] = np.asarray(
            cv2.resize(height, size, interpolation=method), np.float32
        )
        self.depth: NDArray[np.float32] = self._measure_depth()
        self._surface = np.asarray(np.rint(255 * (1 - self.height)), np.uint8)

    def feeler(self, position_mm: NDArray[np.float64]) -> TextureSampler:
        """Return a sampler for electrodes that move over this relief."""
        return ReliefFeeler(self, position_mm)

    def draw(
        self, left_mm: float, top_mm: float, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return a part of the relief as gray levels, (H, W) uint8. Dark pixels are high places."""
        by_x, by_y = pixel_mm / self.scale_mm[0], pixel_mm / self.scale_mm[1]
        left, top = left_mm / self.scale_mm[0], top_mm / self.scale_mm[1]
        to_map = np.array([[by_x, 0, left + by_x / 2 - 0.5], [0, by_y, top + by_y / 2 - 0.5]])
        drawn = cv2.warpAffine(
            self._surface,
            to_map,
            shape[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=255,
        )
        return np.asarray(drawn, np.uint8)

    def _measure_depth(self) -> NDArray[np.float32]:
        """Return the depth of each place within a raised area, (H, W) mm."""
        half = self.grain_mm / 2
        margin = math.ceil(_AROUND * self.grain_mm / self.pixel_mm)
        # Repeat the heights at the edge, so that places there have surroundings on all sides.
        wide = cv2.copyMakeBorder(self.height, *(margin,) * 4, cv2.BORDER_REPLICATE)
        # Two box filters approximate a Gaussian. Their cost does not depend on their width.
        side = 2 * round(_AROUND * self.grain_mm / self.pixel_mm / 2) + 1
        around = cv2.blur(cv2.blur(wide, (side, side)), (side, side))
        blur_mm = min(self.grain_mm / 10, _BLUR_MM)
        wide = cv2.GaussianBlur(wide, (0, 0), blur_mm / self.pixel_mm)
        threshold = np.clip(around, _LOWEST, _HIGHEST)
        high = np.zeros(wide.shape, np.uint8)
        inside = (slice(margin, -margin), slice(margin, -margin))
        high[inside] = (wide > threshold)[inside]
        depth = cv2.distanceTransform(high, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * self.pixel_mm
        depth = cv2.GaussianBlur(np.minimum(depth, half), (0, 0), 1.0)
        return np.asarray(depth[inside].copy(), np.float32)


_STROKE = 0.15
"""Smallest depth, as a share of `grain_mm`, at which an electrode pulses after each `grain_mm` of
motion. At a smaller depth, an electrode pulses only at crests."""
_STEP = 1.25  # distance between samples along the path, in pixels of the map
_MOST_SAMPLES = 64
_FULL = 0.96
"""A place counts as fully deep at this share of the full depth (half a grain) or more. The share is
below 1, because rounding and blur reduce depth."""
_LEAST_RISE = 0.5
"""A maximum of depth is a crest only if depth has risen enough since the last pulse. The rise is
counted from the smallest depth since then. It must be at least this share of the depth at the
maximum. Smaller rises, as on a path along a ridge, are ignored."""


class ReliefFeeler:
    """Sampler that measures depth along the path of each electrode and finds the crests."""

    # Places are complex numbers, x + iy in mm, which is twice as fast as two arrays.

    def __init__(self, relief: Relief, position_mm: NDArray[np.float64]) -> None:
        self._relief = relief
        x_mm, y_mm = relief.scale_mm
        self._own_x = (position_mm[:, 0] / x_mm - 0.5).astype(np.float32)
        self._own_y = (position_mm[:, 1] / y_mm - 0.5).astype(np.float32)
        self._step_mm = _STEP * relief.pixel_mm
        self._full_mm = np.float32(_FULL * relief.grain_mm / 2)
        self._least_mm = relief.pixel_mm / 2
        self._ground_mm = np.float32(_STROKE * relief.grain_mm)
        self._within_mm = relief.grain_mm / 2 - float(self._ground_mm)
        """Distance that an electrode moves straight into a wide raised area, from the place where
        depth is `_ground_mm` to the first pulse."""
        self._all = np.arange(len(position_mm))
        self._nothing = RidgeCrossing(np.zeros(len(position_mm), np.float32), 0)
        self._nothing.height.flags.writeable = False
        self.place(0.0, 0.0)

    def place(self, x_mm: float, y_mm: float) -> None:
        """Set the array's center. In a wide raised area, the next pulse is `grain_mm` away."""
        self._place = complex(x_mm, y_mm)
        x, y = self._on_map(np.array([self._place]))
        self._before = np.repeat(self._depth(x, y), 2, axis=0)
        self._lowest = self._before[0].copy()  # smallest depth since each electrode's last pulse
        self._pulsed = np.full(len(self._all), self._place)
        """For each electrode, the place of the array at the electrode's last pulse."""
        self._entered = self._pulsed.copy()
        """For each electrode, the place of the array when the electrode entered a raised area."""

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the array. A motion shorter than the sample distance is added to the next motion."""
        by = complex(x_mm, y_mm) - self._place
        samples = int(abs(by) / self._step_mm)
        if not samples:
            return self._nothing
        step = by * (self._step_mm / abs(by))
        if samples > _MOST_SAMPLES:
            samples, step = _MOST_SAMPLES, by / _MOST_SAMPLES
        # Include the last two samples of the previous move. The last one can be a maximum, but
        # this shows only in the next sample.
        places = np.asarray(self._place + step * np.arange(-1, samples + 1), np.complex128)
        x, y = self._on_map(places)
        depth = np.concatenate([self._before, self._depth(x[2:], y[2:])])
        self._place = complex(places[-1])
        self._before = depth[-2:]
        if not depth.any():
            self._lowest = depth[-1]
            self._entered = np.full(len(self._all), self._place)
            return self._nothing
        return self._crossing(places, depth, abs(step), (x, y))

    def _crossing(
        self,
        places: NDArray[np.complex128],
        depth: NDArray[np.float32],
        step_mm: float,
        on_map: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> RidgeCrossing:
        lowest = np.minimum.accumulate(np.minimum(depth, self._lowest), axis=0)
        is_crest, last, merged = self._crests(depth, lowest, step_mm)
        inside = self._inside(places, depth) & ~is_crest
        pulsed = is_crest | inside
        if not pulsed.any():
            self._lowest = lowest[-1]
            return self._nothing
        self._lowest = np.where(pulsed, depth[-1], lowest[-1])
        # A pulse can be late. Measure the distance to the next one from where this one was due.
        gone, grain_mm = places[-1] - self._pulsed, self._relief.grain_mm
        gone_mm = np.maximum(np.abs(gone), grain_mm)
        over = gone_mm - grain_mm < step_mm * (len(places) - 2)
        due = self._pulsed + gone * np.where(over, grain_mm / gone_mm, 1.0)
        self._pulsed = np.where(is_crest, places[last], np.where(inside, due, self._pulsed))
        row = np.where(is_crest, last, len(places) - 1)
        x, y = (coordinates[row, self._all][None] for coordinates in on_map)
        height = self._sample(self._relief.height, x, y)[0]
        return RidgeCrossing(np.asarray(height * pulsed, np.float32), merged)

    def _crests(
        self, depth: NDArray[np.float32], lowest: NDArray[np.float32], step_mm: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.intp], int]:
        """Return which electrodes passed a crest, the sample of their last crest, and the number of
        electrodes that passed more than one crest."""
        middle = depth[1:-1]
        # Of successive samples with equal depth, only the last can be a crest.
        crest = (middle >= depth[:-2]) & (middle > depth[2:]) & (middle > self._least_mm)
        crest &= middle - lowest[1:-1] >= _LEAST_RISE * middle
        last = len(crest) - crest[::-1].argmax(axis=0)
        is_crest = crest[last - 1, self._all]
        if not is_crest.any():
            return is_crest, last, 0
        own_mm = depth[last, self._all]
        apart_mm = (last - 1 - crest.argmax(axis=0)) * step_mm
        merged = int((is_crest & (apart_mm >= np.maximum(own_mm, step_mm))).sum())
        return is_crest, last, merged

    def _inside(
        self, places: NDArray[np.complex128], depth: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Return which electrodes on raised areas moved `grain_mm` or more since the last pulse."""
        low = depth[1:] < self._ground_mm
        entered = places[len(low) - low[::-1].argmax(axis=0)]
        self._entered = np.where(low.any(axis=0), entered, self._entered)
        inside: NDArray[np.bool_] = ~low[-1]
        if inside.any():
            inside &= np.abs(places[-1] - self._pulsed) >= self._relief.grain_mm
            inside &= np.abs(places[-1] - self._entered) >= self._within_mm
        return inside

    def _on_map(
        self, places: NDArray[np.complex128]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the column and the row of each electrode on the map, both (N, E), for N places of
        the array."""
        x_mm, y_mm = self._relief.scale_mm
        x, y = places.real / x_mm, places.imag / y_mm
        return (
            x.astype(np.float32)[:, None] + self._own_x,
            y.astype(np.float32)[:, None] + self._own_y,
        )

    def _depth(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the depth at places on the map, (N, E) mm, at most `_full_mm`."""
        return np.minimum(self._sample(self._relief.depth, x, y), self._full_mm)

    def _sample(
        self, values: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        constant = cv2.BORDER_CONSTANT
        sampled = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=constant, borderValue=0)
        return np.asarray(sampled, np.float32)


_NUMBER = r"([0-9]*\.?[0-9]+)"


def open_texture(
    spec: str,
    *,
    # An image that states no scale needs dpi or width_mm. For a text, width_mm is its width.
    dpi: float | None = None,
    width_mm: float | None = None,
    # distance between two pulses on a wide raised area, default 2 mm
    grain_mm: float | None = None,
    light_on_dark: bool = False,  # whether bright is high
) -> Texture:
    """Open a texture: ``grating:4mm``, ``grating:4mm,30deg``, ``text:STRING``, or an image file.
    Dark places are high. ``spec`` can end with options, as in ``wood.png?dpi=300``."""
    asked = {
        "dpi": dpi, "width_mm": width_mm, "grain_mm": grain_mm,
        "light_on_dark": light_on_dark or None,
    }  # fmt: skip
    address, accepted = all_options(open_texture, spec, spec, asked, PageError)
    if address != spec:
        return open_texture(address, **accepted)
    kind, _, rest = spec.partition(":")
    if kind == "grating" and ":" in spec:
        for name in accepted:
            message = f"{name} is for images, not for {spec}: leave it out"
            raise PageError(message)
        return _grating(spec, rest)
    if kind == "text" and ":" in spec:
        if dpi is not None:
            message = "dpi is for images, not for texts: give width_mm"
            raise PageError(message)
        heights = print_heights(rest, width_mm)
    else:
        heights = load_heights(Path(spec), dpi, width_mm)
    return Relief(heights, GRAIN_MM if grain_mm is None else grain_mm, light_on_dark)


def _grating(spec: str, rest: str) -> Texture:
    match = re.fullmatch(rf"\s*{_NUMBER}\s*(mm)?\s*(,\s*([-+]?){_NUMBER}\s*(deg|°)?)?\s*", rest)
    if match is None:
        message = f"{spec!r} is not a grating: write grating:4mm or grating:4mm,30deg"
        raise PageError(message)
    pitch_mm, sign, angle = float(match[1]), match[4], float(match[5] or 0)
    return Grating(pitch_mm, -angle if sign == "-" else angle)
