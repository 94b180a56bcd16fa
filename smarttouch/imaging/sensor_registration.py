"""Registration of the sensor with the electrodes: the pixels under each electrode."""

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ProfileError
from smarttouch.profile import Optics
from smarttouch.profile.electrodes import ElectrodeArray

PIXELS_PER_CELL = 8
"""Number of pixels across an electrode's cell. Finer frames are reduced to this resolution."""
_SAMPLES = 6  # points along each side of a pixel; they show which share of it is inside a cell


class Apertures(NamedTuple):
    """Indexes and weights of the pixels under each electrode. An electrode has at most P pixels."""

    pixel: NDArray[np.intp]  # (P, E) index of each pixel in the flattened frame
    share: NDArray[np.float32]  # (P, E) weight of each pixel, divided by the value of ink, 255


class Registration:
    """Registration of frames with an array, to average the ink in the aperture of each electrode.

    The aperture of an electrode is the electrode's cell, divided by the magnification. The weight
    of a pixel is its area inside the aperture. Frames are reduced to `working_shape`, which follows
    from `PIXELS_PER_CELL`. Raises ProfileError for an impossible homography.
    """

    def __init__(
        self, electrodes: ElectrodeArray, optics: Optics, frame_shape: tuple[int, int]
    ) -> None:
        cell_mm = min(electrodes.cell_mm) / optics.magnification
        finest = cell_mm / PIXELS_PER_CELL
        rows, columns = frame_shape
        width_mm, height_mm = _field_mm(electrodes, optics)
        self.frame_shape = frame_shape
        self.working_shape: tuple[int, int] = (
            _reduced_side(rows, height_mm / finest),
            _reduced_side(columns, width_mm / finest),
        )
        self._averages = [
            (np.empty(shape, np.uint8), kind)
            for shape, kind in _averages(frame_shape, self.working_shape)
        ]
        self.apertures: Apertures = _apertures(electrodes, optics, self.working_shape)

    def reduce(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Reduce a frame to the working shape; the next call overwrites the result."""
        for average, kind in self._averages:
            cv2.resize(image, average.shape[::-1], dst=average, interpolation=kind)
            image = average
        return image


def _reduced_side(side: int, wanted: float) -> int:
    """Return the smallest divisor of ``side`` that is at least ``wanted``. OpenCV reduces images
    faster by integer factors."""
    # The tolerance keeps rounding errors from lowering an integer quotient by one.
    largest = math.floor(side / wanted * (1 + 1e-9))
    return side // next(factor for factor in range(max(1, largest), 0, -1) if side % factor == 0)


def _averages(shape: tuple[int, int], to: tuple[int, int]) -> list[tuple[tuple[int, int], int]]:
    """For each step of the reduction, return the new shape and OpenCV's interpolation method.

    Steps by a factor of 2 come first, because they are ten times faster than other factors. At the
    factor 2, linear interpolation returns the mean of the pixels.
    """
    averages = []
    down, across = shape[0] // to[0], shape[1] // to[1]
    while down % 2 == across % 2 == 0:
        down, across, shape = down // 2, across // 2, (shape[0] // 2, shape[1] // 2)
        averages.append((shape, cv2.INTER_LINEAR))
    if shape != to:
        averages.append((to, cv2.INTER_LINEAR if max(down, across) == 2 else cv2.INTER_AREA))
    return averages


@lru_cache(maxsize=8)
def _apertures(electrodes: ElectrodeArray, optics: Optics, shape: tuple[int, int]) -> Apertures:
    rows, columns = shape
    width_mm, height_mm = (side / optics.magnification for side in electrodes.cell_mm)
    field_mm = _field_mm(electrodes, optics, finest=True)
    across = max(2, math.ceil(width_mm / (field_mm[0] / columns) * _SAMPLES))
    down = max(2, math.ceil(height_mm / (field_mm[1] / rows) * _SAMPLES))
    dx, dy = np.meshgrid(
        ((np.arange(across) + 0.5) / across - 0.5) * width_mm,
        ((np.arange(down) + 0.5) / down - 0.5) * height_mm,
    )
    center = electrodes.position_mm / optics.magnification
    x = center[:, 0, None] + dx.ravel()
    y = center[:, 1, None] + dy.ravel()
    across_frame, down_frame = on_frame(x, y, optics)
    column, row = np.floor(across_frame * columns), np.floor(down_frame * rows)
    # Samples outside of the field of view count as paper.
    seen = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    electrode = np.broadcast_to(np.arange(len(electrodes))[:, None], seen.shape)
    pixel = (row[seen] * columns + column[seen]).astype(np.int64)
    pixel_index, samples = np.unique(electrode[seen] * rows * columns + pixel, return_counts=True)
    electrode, pixel = np.divmod(pixel_index, rows * columns)
    counts = np.bincount(electrode, minlength=len(electrodes))
    nth = np.arange(len(pixel_index)) - (counts.cumsum() - counts)[electrode]
    pixels = np.zeros((counts.max(initial=0), len(electrodes)), np.intp)
    shares = np.zeros(pixels.shape, np.float32)
    # The share of a pixel is the sum of the weights of its n samples, `weights.cumsum()[n - 1]`.
    weights = np.full(samples.max(initial=1), 1 / (255 * across * down), np.float32)
    pixels[nth, electrode], shares[nth, electrode] = pixel, weights.cumsum()[samples - 1]
    return Apertures(pixels, shares)


def on_frame(
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], optics: Optics
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Convert places on the page to fractions of frame width and height; NaN behind the camera."""
    if optics.homography is None:
        turn = math.radians(optics.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        across = x_mm * cos - y_mm * sin + optics.offset_x_mm
        down = x_mm * sin + y_mm * cos + optics.offset_y_mm
        return across / optics.field_width_mm + 0.5, down / optics.field_height_mm + 0.5
    a, b, c, d, e, f, g, h, one = optics.homography
    depth = g * x_mm + h * y_mm + one
    # `one` is the depth at the array's middle. Behind the camera, the depth has the other sign.
    depth = np.where(depth * np.sign(one) > 1e-9, depth, np.nan)
    column, row = (a * x_mm + b * y_mm + c) / depth, (d * x_mm + e * y_mm + f) / depth
    return (column + 0.5) / optics.sensor_columns, (row + 0.5) / optics.sensor_rows


def _field_mm(
    electrodes: ElectrodeArray, optics: Optics, finest: bool = False
) -> tuple[float, float]:
    """Return the width and height, mm, of the area of the page that a frame shows.

    With a tilted camera, the scale differs between electrodes. Use the scale with the most pixels
    per mm if ``finest``, otherwise the scale with the fewest.
    """
    if optics.homography is None:
        return optics.field_width_mm, optics.field_height_mm
    x_mm, y_mm = electrodes.position_mm.T / optics.magnification
    step_mm = min(electrodes.cell_mm) / optics.magnification / 100
    middle = np.array(on_frame(x_mm, y_mm, optics))
    right = np.array(on_frame(x_mm + step_mm, y_mm, optics)) - middle
    down = np.array(on_frame(x_mm, y_mm + step_mm, optics)) - middle
    # At each electrode: 1 mm on the page, as a share of the frame's width, and of its height.
    parts = np.hypot(right, down) / step_mm
    chosen = parts.max(axis=1) if finest else parts.min(axis=1)
    if not ((chosen > 0) & (chosen * min(electrodes.cell_mm) <= optics.magnification)).all():
        raise ProfileError(
            "optics.homography puts an electrode outside of the camera's view, or the view is "
            "smaller than one electrode: calibrate the registration again, or remove this key",
            key="optics.homography",
        )
    width_mm, height_mm = (1 / chosen).tolist()
    return width_mm, height_mm
