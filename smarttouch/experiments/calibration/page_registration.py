"""Electrodes in the image of a sensor, found by the printed target; a simulated camera over it."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.calibration.dot_target import Dots, DotTarget, Points, apply, find_dots
from smarttouch.profile import Optics, Profile

FEWEST_DOTS = 12
MOST_RESIDUAL = 0.25  # largest residual of a dot, as a part of an electrode's pitch on the page
MOST_OUTSIDE = 0.25  # largest part of the electrodes outside the image
_OUTLIER = 5.0  # factor of the median residual beyond which dots are dirt
_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class RegistrationFound:
    """A fit, and its residuals."""

    # (3, 3): millimeters on the page around the middle of what the array covers to pixels
    homography: NDArray[np.float64]
    shape: tuple[int, int]  # rows and columns of the image
    electrode_pixel: Points  # (E, 2): column and row at which each electrode looks
    # residual_px, residual_mm: (N,), of each dot, in the image and on the page
    residual_px: NDArray[np.float64]
    residual_mm: NDArray[np.float64]
    pitch_mm: float  # of the electrodes, on the page
    tilt_deg: float  # by how much a square on the page is foreshortened
    mirrored: bool  # the sensor sees the page as in a mirror

    @property
    def rms_mm(self) -> float:
        return float(np.sqrt(np.mean(self.residual_mm**2)))

    @property
    def worst_mm(self) -> float:
        return float(self.residual_mm.max())

    @property
    def rms_px(self) -> float:
        return float(np.sqrt(np.mean(self.residual_px**2)))

    @property
    def outside(self) -> NDArray[np.intp]:
        """Electrodes whose place is outside the image."""
        rows, columns = self.shape
        x, y = self.electrode_pixel.T
        inside = (x >= -0.5) & (x <= columns - 0.5) & (y >= -0.5) & (y <= rows - 0.5)
        return np.flatnonzero(~inside)

    def sentence(self) -> str:
        """Return the sentence for the profile."""
        return (
            f"{len(self.residual_px)} dots in {self.shape[1]} × {self.shape[0]} pixels, residual "
            f"rms {self.rms_px:.2f} px, {self.rms_mm:.4f} mm, {self.rms_mm / self.pitch_mm:.3f} "
            f"of a pitch on the page, worst {self.residual_px.max():.2f} px, "
            f"{self.worst_mm:.4f} mm, {self.worst_mm / self.pitch_mm:.3f}; "
            f"tilt {self.tilt_deg:.1f}°"
            + (", mirrored" if self.mirrored else "")
            + (f"; {len(self.outside)} electrodes look beyond the image" * bool(len(self.outside)))
        )


def register(image: NDArray[np.uint8], profile: Profile, target: DotTarget) -> RegistrationFound:
    """Fit the place on the page of each pixel, from one image (H, W) of the target or a mean of
    several.

    The center of the array is the middle of the L.
    """
    dots = find_dots(image)
    dots = _within(dots, target)
    homography, kept = _fit(dots, target)
    measured, page_mm = dots.pixel[kept], _page_mm(dots, target)[kept]
    expected = _seen_centers(homography, page_mm, target.radius_mm(*dots.cell[kept].T))
    back = np.linalg.inv(homography)
    residual_mm = np.linalg.norm(apply(back, measured) - apply(back, expected), axis=1)
    electrodes = profile.electrodes
    places_mm = electrodes.position_mm / profile.optics.magnification
    scale, mirrored = _linear(homography)
    found = RegistrationFound(
        homography,
        (image.shape[0], image.shape[1]),
        apply(homography, places_mm),
        np.linalg.norm(measured - expected, axis=1),
        residual_mm,
        electrodes.pitch_mm / profile.optics.magnification,
        float(np.degrees(np.arccos(min(1.0, scale[1] / scale[0])))),
        mirrored,
    )
    _require_good(found)
    return found


def _within(dots: Dots, target: DotTarget) -> Dots:
    there = np.abs(dots.cell).max(axis=1, initial=0) <= target.reach
    if there.sum() < FEWEST_DOTS:
        raise CalibrationError(
            f"{int(there.sum())} dots of the target are seen, {FEWEST_DOTS} are needed: bring more "
            "of it into view, or print it with dots closer together"
        )
    return Dots(dots.pixel[there], dots.cell[there])


def _page_mm(dots: Dots, target: DotTarget) -> Points:
    return np.asarray(dots.cell * target.pitch_mm, np.float64)


def _fit(dots: Dots, target: DotTarget) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the homography from page to pixels, and the dots it was fitted to."""
    page_mm, radius = _page_mm(dots, target), target.radius_mm(*dots.cell.T)
    kept = np.ones(len(page_mm), bool)
    aim = dots.pixel.copy()
    homography = np.eye(3)
    for _ in range(_ROUNDS):
        fitted, _ = cv2.findHomography(page_mm[kept], aim[kept], 0)
        if fitted is None:
            raise CalibrationError("the dots lie on one line: bring more of the target into view")
        homography = np.asarray(fitted, np.float64)
        # A tilted disc is seen as an ellipse, and its middle is not where the disc's middle is.
        aside = _seen_centers(homography, page_mm, radius) - apply(homography, page_mm)
        aim = dots.pixel - aside
        away = np.linalg.norm(apply(homography, page_mm) - aim, axis=1)
        fine = away <= _OUTLIER * max(float(np.median(away)), 0.02)
        if fine.sum() >= FEWEST_DOTS:
            kept = fine
    return homography / homography[2, 2], kept


def _seen_centers(
    homography: NDArray[np.float64], page_mm: Points, radius_mm: NDArray[np.float64]
) -> Points:
    """Return the centers of the ellipses that discs appear as.

    By dual conics: a disc's is p pᵀ − r² diag(1, 1, 0), a homography H takes it to
    H C Hᵀ, and an ellipse's middle is its dual conic's last column (Hartley and Zisserman,
    Multiple View Geometry, Section 2.2.3).
    """
    place = np.column_stack([page_mm, np.ones(len(page_mm))])
    conic = place[:, :, None] * place[:, None, :]
    conic[:, 0, 0] -= radius_mm**2
    conic[:, 1, 1] -= radius_mm**2
    seen = homography @ conic @ homography.T
    return np.asarray(seen[:, :2, 2] / seen[:, 2:, 2])


def _linear(homography: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return pixels per millimeter along both axes at the view's middle; whether mirrored."""
    offset = homography[:2, 2:] @ homography[2:, :2] / homography[2, 2]
    linear = (homography[:2, :2] - offset) / homography[2, 2]
    return np.linalg.svd(linear, compute_uv=False), bool(np.linalg.det(linear) < 0)


def _require_good(found: RegistrationFound) -> None:
    worst = found.worst_mm / found.pitch_mm
    if not worst <= MOST_RESIDUAL:
        raise CalibrationError(
            f"the dots are up to {worst:.2f} of an electrode's pitch from where they should be, "
            f"above {MOST_RESIDUAL:g}: lay the target flat, check its dots and the lens"
        )
    count = len(found.electrode_pixel)
    if len(found.outside) > MOST_OUTSIDE * count:
        raise CalibrationError(
            f"{len(found.outside)} of {count} electrodes look beyond the image: move the target's "
            "L under the middle of the array, or check optics.magnification"
        )


_SAMPLES, _FINE_SAMPLES = 4, 2
"""Rays per pixel and axis, of coarse images and of fine ones, whose pixels are blurred anyway."""
_FINE = 256
_INK_LEVEL = 0.15  # reflectance of black print


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
    zoom: float = 1.0  # pixels per millimeter, as a part of the profile's
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
