"""Electrodes in the image of a sensor, found by a printed target; a simulated camera over it."""

import math
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from smarttouch.base.errors import CalibrationError, require_within
from smarttouch.base.files import write_bytes
from smarttouch.profile import Optics, Profile

Matrix = NDArray[np.floating[Any]]
Gray = NDArray[np.integer[Any] | np.floating[Any]]

MARKERS = 3  # in a row of the target
MODULES = 7 * MARKERS - 1  # across the target: 6 for each marker and one between two
FIELD_SHARE = 1.5  # side of the target, as a part of the field: it need not be laid exactly
FEWEST_PIXELS = 24  # fewest pixels a side; with fewer, no marker is recognized
LEAST_CORRELATION = 0.8  # of the image with the target; 0.9 and more where it lies flat
MOST_OUTSIDE = 0.25  # largest part of the electrodes outside the image
DOTS_PER_MM = 50  # of the print
_SIZES_MM = (1.0, 200.0)
_MARGIN_MM = 8.0
_WORKING_SIDE = 240  # pixels of the shorter side at which markers are detected
_MODULE_PX, _QUIET = 12, 2  # pixels of a module in `picture`, and modules of white around it


@dataclass(frozen=True)
class PageTarget:
    """Square of ArUco markers on paper; its middle is laid under the middle of the array."""

    module_mm: float

    @property
    def side_mm(self) -> float:
        return MODULES * self.module_mm

    @property
    def to_mm(self) -> Matrix:
        """Map, (3, 3), from pixels of `picture` to millimeters around the middle."""
        scale = self.module_mm / _MODULE_PX
        middle = (MODULES + 2 * _QUIET) / 2 * self.module_mm
        return np.array([[scale, 0, scale / 2 - middle], [0, scale, scale / 2 - middle], [0, 0, 1]])

    def draw(self, path: Path) -> None:
        """Write the target as a PNG file with its resolution."""
        margin, side = round(_MARGIN_MM * DOTS_PER_MM), round(self.side_mm * DOTS_PER_MM)
        image = Image.new("L", (side + 2 * margin,) * 2, 255)
        image.paste(Image.fromarray(_board().generateImage((side, side))), (margin, margin))
        text = f"SmartTouch, this side up: print at 100 %, measure {self.side_mm:g} mm across"
        pen, size = ImageDraw.Draw(image), 2.2 * DOTS_PER_MM
        while pen.textlength(text, font_size=size) > image.width - 2 * DOTS_PER_MM:
            size *= 0.9
        pen.text((DOTS_PER_MM, DOTS_PER_MM), text, fill=0, font_size=size)
        content = BytesIO()
        image.save(content, format="PNG", dpi=(25.4 * DOTS_PER_MM,) * 2)
        write_bytes(path, content.getvalue(), CalibrationError)


def target_for(profile: Profile, size_mm: float | None = None) -> PageTarget:
    """Return the target for a sensor, somewhat larger than its field, or of about a given side."""
    optics = profile.optics
    pixels = min(optics.sensor_columns, optics.sensor_rows)
    if size_mm is None:
        if pixels < FEWEST_PIXELS:
            raise CalibrationError(
                f"{optics.sensor_columns} × {optics.sensor_rows} pixels are too coarse for a "
                f"target: {FEWEST_PIXELS} a side are needed; set optics.rotation_deg, offset_x_mm "
                "and offset_y_mm by hand, or give the size if the sensor is finer than that"
            )
        size_mm = FIELD_SHARE * min(optics.field_width_mm, optics.field_height_mm)
    require_within(CalibrationError, "size_mm", size_mm, *_SIZES_MM)
    return PageTarget(max(1, round(size_mm / MODULES * DOTS_PER_MM)) / DOTS_PER_MM)


@cache
def _board() -> Any:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    return cv2.aruco.GridBoard((MARKERS, MARKERS), 6, 1, dictionary)


@cache
def picture() -> NDArray[np.uint8]:
    """Return the target's gray levels, with some paper around it."""
    printed = _board().generateImage((MODULES * _MODULE_PX,) * 2)
    around = (_QUIET * _MODULE_PX,) * 4
    made = cv2.copyMakeBorder(printed, *around, cv2.BORDER_CONSTANT, value=255)
    return np.asarray(made, np.uint8)


def apply(homography: Matrix, points: Matrix) -> NDArray[np.float64]:
    """Return the points, (N, 2), mapped by a homography."""
    carried = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(carried[:, :2] / carried[:, 2:])


@dataclass(frozen=True, eq=False)
class RegistrationFound:
    """A fit, and how well the image agrees with it."""

    # (3, 3): millimeters on the page around the middle of what the array covers to pixels
    homography: NDArray[np.float64]
    shape: tuple[int, int]  # rows and columns of the image
    electrode_pixel: NDArray[np.float64]  # (E, 2): column and row at which each electrode looks
    markers: int  # number of markers recognized
    correlation: float  # of the image with the target there, 1 where they are alike
    tilt_deg: float  # by how much a square on the page is foreshortened
    mirrored: bool  # the sensor sees the page as in a mirror

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
            f"{self.markers} markers in {self.shape[1]} × {self.shape[0]} pixels, correlation "
            f"{self.correlation:.3f}; tilt {self.tilt_deg:.1f}°"
            + (", mirrored" if self.mirrored else "")
            + (f"; {len(self.outside)} electrodes look beyond the image" * bool(len(self.outside)))
        )


def register(image: NDArray[np.uint8], profile: Profile, target: PageTarget) -> RegistrationFound:
    """Fit the place on the page of each pixel, from one image (H, W) of the target or a mean of
    several."""
    rows, columns = image.shape
    if min(rows, columns) < FEWEST_PIXELS:
        raise CalibrationError(
            f"an image of {columns} × {rows} pixels is too coarse: {FEWEST_PIXELS} a side are "
            "needed"
        )
    scale = _WORKING_SIDE / min(rows, columns)
    size = round(columns * scale), round(rows * scale)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    working = cv2.resize(image, size, interpolation=method)
    mirror = np.eye(3)
    found = _markers(working)
    if found is None:
        mirror = np.array([[-1.0, 0, size[0] - 1], [0, 1, 0], [0, 0, 1]])
        working = np.ascontiguousarray(working[:, ::-1])
        found = _markers(working)
    if found is None:
        raise CalibrationError(
            "no marker of the target is recognized: lay it under the sensor, light it, and bring "
            "it into focus"
        )
    to_working, correlation = _aligned(working, *found)
    if not correlation >= LEAST_CORRELATION:
        raise CalibrationError(
            f"the image agrees with the target to {correlation:.2f}, below "
            f"{LEAST_CORRELATION:g}: lay the target flat, bring more of it into view, and check "
            "the lens"
        )
    grown = np.array(
        [[1 / scale, 0, 0.5 / scale - 0.5], [0, 1 / scale, 0.5 / scale - 0.5], [0, 0, 1]]
    )
    homography = grown @ mirror @ to_working @ np.linalg.inv(target.to_mm)
    homography /= homography[2, 2]
    places_mm = profile.electrodes.position_mm / profile.optics.magnification
    axes, mirrored = _linear(homography)
    tilt_deg = float(np.degrees(np.arccos(min(1.0, axes[1] / axes[0]))))
    registered = RegistrationFound(
        homography, (rows, columns), apply(homography, places_mm), len(found[0]) // 4, correlation,
        tilt_deg, mirrored,
    )  # fmt: skip
    _require_in_view(registered)
    return registered


def _markers(working: Gray) -> tuple[Matrix, Matrix] | None:
    """Return the corners of the markers in an image, (N, 2): in modules of the target, and in
    pixels; None if there are none."""
    parameters = cv2.aruco.DetectorParameters()
    # A module is up to 15 pixels wide in an image that was enlarged so much.
    parameters.adaptiveThreshWinSizeMax = 53
    detector = cv2.aruco.ArucoDetector(_board().getDictionary(), parameters)
    corners, ids, _ = detector.detectMarkers(working)
    if ids is None:
        return None
    modules, pixels = _board().matchImagePoints(corners, ids)
    if modules is None:
        return None
    return modules.reshape(-1, 3)[:, :2].astype(np.float64), pixels.reshape(-1, 2)


def _aligned(working: Gray, modules: Matrix, pixels: Matrix) -> tuple[Matrix, float]:
    """Return the homography from pixels of `picture` to those of an image, and how well they
    correlate.

    Blur moves the corners of markers, so they are the first guess alone: the whole picture is then
    laid on the image (Evangelidis and Psarakis 2008, enhanced correlation coefficient).
    """
    guess, _ = cv2.findHomography((modules + _QUIET) * _MODULE_PX - 0.5, pixels, 0)
    if guess is None:
        return np.eye(3), 0.0
    blurred = cv2.GaussianBlur(picture(), (0, 0), _MODULE_PX / 3)
    ends = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-5)
    start = guess.astype(np.float32)
    try:
        correlation, fitted = cv2.findTransformECC(
            blurred, working, start, cv2.MOTION_HOMOGRAPHY, ends
        )
    except cv2.error:
        # It goes astray where nothing fits.
        return np.eye(3), 0.0
    return np.asarray(fitted, np.float64), float(correlation)


def _linear(homography: NDArray[np.float64]) -> tuple[NDArray[np.float64], bool]:
    """Return pixels per millimeter along both axes at the view's middle; whether mirrored."""
    offset = homography[:2, 2:] @ homography[2:, :2] / homography[2, 2]
    linear = (homography[:2, :2] - offset) / homography[2, 2]
    return np.linalg.svd(linear, compute_uv=False), bool(np.linalg.det(linear) < 0)


def _require_in_view(found: RegistrationFound) -> None:
    count = len(found.electrode_pixel)
    if len(found.outside) > MOST_OUTSIDE * count:
        raise CalibrationError(
            f"{len(found.outside)} of {count} electrodes look beyond the image: move the target's "
            "middle under the middle of the array, or check optics.magnification"
        )


_SAMPLES = 4  # rays per pixel and axis
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
        self, target: PageTarget, optics: Optics, shape: tuple[int, int]
    ) -> NDArray[np.uint8]:
        """Return the camera's image of the target."""
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

    def _light(self, random: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.float64]:
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
        angle = random.uniform(0, 2 * np.pi)
        slope = np.cos(angle) * x + np.sin(angle) * y
        return np.asarray(1 + self.uneven * (0.5 * slope - 0.25 * (x * x + y * y)))


def bench_view(target: PageTarget, optics: Optics) -> NDArray[np.uint8]:
    """Return the view of a slightly tilted camera, for demonstrations."""
    view = View(tilt_deg=12, toward_deg=40, turn_deg=5, offset_mm=(0.1, -0.05), zoom=0.9)
    return view.render(target, optics, (optics.sensor_rows, optics.sensor_columns))
