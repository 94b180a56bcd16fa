"""Simulated camera over a simulated target, with a known homography."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.calibrate.dots import apply
from smarttouch.calibrate.target import DotTarget
from smarttouch.profile import Optics

_SAMPLES, _FINE_SAMPLES = 4, 2
"""Rays per pixel and axis, of coarse images and of fine ones, whose pixels are blurred anyway."""
_FINE = 256
_INK_LEVEL = 0.15
"""Reflectance of black print."""


@dataclass(frozen=True)
class View:
    """Pose of a camera over the page."""

    # tilt_deg, toward_deg: between the line of sight and the page's normal, and which way it leans
    tilt_deg: float = 0.0
    toward_deg: float = 0.0
    turn_deg: float = 0.0  # about the line of sight
    offset_mm: tuple[float, float] = (0.0, 0.0)  # place on the page at the middle of the image
    # from the page, along the line of sight; perspective grows as it falls
    distance_mm: float = 30.0
    zoom: float = 1.0  # pixels per millimeter, of what the profile says
    # blur_px, noise_levels: of the optics and of the sensor, standard deviations
    blur_px: float = 0.5
    noise_levels: float = 2.0
    uneven: float = 0.3  # by how much of itself the light varies over the image
    seed: int = 0  # of the noise, and of where the light comes from

    def homography(self, optics: Optics, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the map from page to pixels: a pinhole camera over a plane."""
        rows, columns = shape
        scale = self.zoom * min(columns / optics.field_width_mm, rows / optics.field_height_mm)
        focal = scale * self.distance_mm
        lens = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1]])
        axis = np.radians(self.toward_deg)
        lean = np.array([np.cos(axis), np.sin(axis), 0.0]) * math.radians(self.tilt_deg)
        tilt, _ = cv2.Rodrigues(lean)
        turn, _ = cv2.Rodrigues(np.array([0.0, 0.0, math.radians(self.turn_deg)]))
        attitude = np.asarray(tilt @ turn, np.float64)
        x_mm, y_mm = self.offset_mm
        away = np.array([0, 0, self.distance_mm]) - attitude @ np.array([x_mm, y_mm, 0.0])
        seen = lens @ np.column_stack([attitude[:, :2], away])
        return np.asarray(seen / seen[2, 2])

    def render(
        self, target: DotTarget, optics: Optics, shape: tuple[int, int]
    ) -> NDArray[np.uint8]:
        """Return the camera's image of the target."""
        random = np.random.default_rng(self.seed)
        back = np.linalg.inv(self.homography(optics, shape))
        rows, columns = shape
        samples = _SAMPLES if min(shape) < _FINE else _FINE_SAMPLES
        fine = [(np.arange(side * samples) + 0.5) / samples - 0.5 for side in (columns, rows)]
        x, y = np.meshgrid(*fine)
        x_mm, y_mm = apply(back, np.column_stack([x.ravel(), y.ravel()])).T
        ink = target.ink(x_mm, y_mm).reshape(rows, samples, columns, samples).mean(axis=(1, 3))
        blurred = cv2.GaussianBlur(1 - (1 - _INK_LEVEL) * ink, (0, 0), max(self.blur_px, 1e-3))
        image = 190 * np.asarray(blurred, np.float64) * self._light(random, shape)
        image += self.noise_levels * random.standard_normal(shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _light(self, random: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float64]:
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
        angle = random.uniform(0, 2 * np.pi)
        slope = np.cos(angle) * x + np.sin(angle) * y
        return np.asarray(1 + self.uneven * (0.5 * slope - 0.25 * (x * x + y * y)))


def bench_view(target: DotTarget, optics: Optics) -> NDArray[np.uint8]:
    """Return the view of a slightly tilted camera, for demonstrations."""
    view = View(tilt_deg=12, toward_deg=40, turn_deg=5, offset_mm=(0.1, -0.05), zoom=0.9)
    return view.render(target, optics, (optics.sensor_rows, optics.sensor_columns))
