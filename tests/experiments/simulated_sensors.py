"""Simulated sensors with known properties: a load cell, an optical sensor, a camera."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from smarttouch.experiments.contact_and_force_calibration import STANDARD_GRAVITY
from smarttouch.experiments.sensor_calibration import picture


@dataclass
class SimulatedCell:
    """Load cell with noise, outliers and missing readings."""

    # counts_per_n: counts per newton; zero: reading without force
    counts_per_n: float = 4.1e5
    zero: float = 83_000.0
    noise_n: float = 0.002  # standard deviation of a reading
    garbage: float = 0.0  # share of readings with random values
    missing: float = 0.0  # share of readings that are NaN
    seed: int = 0
    rate_hz: float = 80.0
    grams: float = 0.0  # weight on the cell

    def __post_init__(self):
        self._random = np.random.default_rng(self.seed)

    def collect(self, seconds):
        """Return the readings of this duration, without waiting."""
        random, count = self._random, round(seconds * self.rate_hz)
        readings = self.grams / 1000 * STANDARD_GRAVITY + self.noise_n * random.standard_normal(
            count
        )
        readings = self.zero + self.counts_per_n * readings
        wild = random.random(count) < self.garbage
        readings[wild] = random.uniform(-(2**23), 2**23, int(wild.sum()))
        readings[random.random(count) < self.missing] = np.nan
        return np.rint(readings)


@dataclass(frozen=True, eq=False)
class SimulatedPatch:
    """Optical sensor with uneven light. Gain and dark level of its pixels vary; some are broken."""

    shape: tuple[int, int] = (64, 64)
    noise_levels: float = 2.0
    dead: int = 0
    hot: int = 0
    seed: int = 0

    def images(self, count, *, light):
        """Return images of blank paper, with or without light."""
        return self.see(np.full(self.shape, 1.0 if light else 0.0), count)

    def see(self, scene, count: int = 1):
        """Return images of a scene, (H, W) in [0, 1]: 0 is no light, 1 is white paper."""
        fixed = np.random.default_rng(self.seed)
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in self.shape), indexing="ij")
        gain = 1 + 0.1 * x - 0.15 * (x * x + y * y)
        gain *= 1 + 0.05 * fixed.standard_normal(self.shape)
        dark = 14 + 2 * fixed.standard_normal(self.shape)
        broken = fixed.permutation(gain.size)
        gain.ravel()[broken[: self.dead]] = 0.02
        dark.ravel()[broken[self.dead : self.dead + self.hot]] += 120
        fresh = np.random.default_rng((self.seed, count, int(1e6 * scene.mean())))
        noise = self.noise_levels * fresh.standard_normal((count, *self.shape))
        seen = np.rint(dark + 190 * gain * scene + noise)
        return list(np.clip(seen, 0, 255).astype(np.uint8))


_SAMPLES = 4  # samples of a pixel along each axis
_INK_LEVEL = 0.15  # reflectance of black print


@dataclass(frozen=True)
class View:
    """Camera above a page: pose, optics and light."""

    # tilt_deg: angle between line of sight and page normal; toward_deg: direction of the tilt axis
    tilt_deg: float = 0.0
    toward_deg: float = 0.0
    turn_deg: float = 0.0  # rotation about the line of sight
    offset_mm: tuple[float, float] = (0.0, 0.0)  # point of the page at the image center
    # distance from the page along the line of sight; a smaller distance gives more perspective
    distance_mm: float = 30.0
    zoom: float = 1.0  # pixels per millimeter, relative to the value in the profile
    # blur_px, noise_levels: standard deviations of the optics' blur and the sensor's noise
    blur_px: float = 0.5
    noise_levels: float = 2.0
    uneven: float = 0.3  # relative variation of the light over the image
    seed: int = 0  # seed of the noise and of the light's direction

    def homography(self, optics, shape):
        """Return the homography of a pinhole camera, (3, 3). It maps the page, mm, to pixels."""
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

    def render(self, target, optics, shape):
        """Return the camera's image of a printed target, (H, W) uint8."""
        random = np.random.default_rng(self.seed)
        rows, columns = shape
        half = (_SAMPLES - 1) / 2
        fine = np.array([[_SAMPLES, 0, half], [0, _SAMPLES, half], [0, 0, 1]])
        seen = fine @ self.homography(optics, shape) @ target.to_mm
        size = columns * _SAMPLES, rows * _SAMPLES
        rays = cv2.warpPerspective(picture(), seen, size, borderValue=(255,))
        paper = cv2.resize(rays, (columns, rows), interpolation=cv2.INTER_AREA) / 255
        reflected = _INK_LEVEL + (1 - _INK_LEVEL) * paper
        blurred = cv2.GaussianBlur(reflected, (0, 0), max(self.blur_px, 1e-3))
        image = 190 * np.asarray(blurred, np.float64) * self._light(random, shape)
        image += self.noise_levels * random.standard_normal(shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def _light(self, random, shape):
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
        angle = random.uniform(0, 2 * np.pi)
        slope = np.cos(angle) * x + np.sin(angle) * y
        return np.asarray(1 + self.uneven * (0.5 * slope - 0.25 * (x * x + y * y)))
