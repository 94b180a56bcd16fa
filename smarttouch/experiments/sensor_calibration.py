"""Calibration of an optical sensor: its flat field, and its registration with the electrodes."""

import time
from collections.abc import Sequence
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
from smarttouch.profile import Profile
from smarttouch.sources import open_source
from smarttouch.sources.flat_field_and_motion import FlatField, mean_image
from smarttouch.sources.source_contract import Source

Images = list[NDArray[np.uint8]]

IMAGE_TIMEOUT_S = 5.0  # longest wait for a new image
_POLL_S = 0.002


def images_of(url: str, profile: Profile, count: int, *, corrected: bool) -> Images:
    """Collect images from the source at a URL. ``corrected`` applies the profile's flat field."""
    # Files need not be read at their frame rate.
    from_file = url.startswith(("frames:", "video:")) and "unpaced" not in url
    seen_by = profile if corrected else uncorrected(profile)
    with open_source(url, seen_by, unpaced=from_file or None) as source:
        return collect_images(source, count)


def collect_images(source: Source, count: int) -> Images:
    """Collect ``count`` distinct images of a source, or fewer if the source ends early."""
    images: Images = []
    seen: set[int] = set()
    start = time.perf_counter_ns()
    last = time.monotonic()
    while len(images) < count:
        frame = source.read(time.perf_counter_ns() - start)
        if frame is None:
            break
        if frame.number not in seen and not frame.stale and frame.image is not None:
            seen.add(frame.number)
            images.append(frame.image.copy())
            last = time.monotonic()
        elif time.monotonic() - last > IMAGE_TIMEOUT_S:
            raise CalibrationError(
                f"{source.title} sent {len(images)} of {count} frames, then none for "
                f"{IMAGE_TIMEOUT_S:g} s: check the connection of the sensor"
            )
        else:
            time.sleep(_POLL_S)
    if not images:
        raise CalibrationError(f"{source.title} sent no frames: check the source")
    return images


def uncorrected(profile: Profile) -> Profile:
    """Return a copy of the profile without its flat field, for raw images."""
    optics = profile.optics.model_copy(update={"flat_field": None})
    return profile.model_copy(update={"optics": optics})


_Stack = Sequence[NDArray[np.uint8]]

MOST_UNEVEN = 0.05
"""Largest allowed unevenness after correction. Printed or moved paper is more uneven."""


@dataclass(frozen=True, eq=False)
class OpticsFound:
    """Flat field of a sensor, and the unevenness of blank paper before and after correction."""

    field: FlatField
    # Unevenness is the standard deviation of the gray levels of blank paper, divided by their mean.
    uneven_before: float
    uneven_after: float  # measured in frames not used for the flat field, if there are several

    def sentence(self) -> str:
        """Return the sentence that the profile stores about this result."""
        columns, rows = self.field.gain.shape[::-1]
        return (
            f"{columns} × {rows} pixels, unevenness of blank paper {self.uneven_before:.1%} before "
            f"and {self.uneven_after:.1%} after correction, {self.field.broken} dead or hot pixels"
        )


def measure_optics(dark: _Stack, white: _Stack) -> OpticsFound:
    """Compute a sensor's flat field from images in the dark and of blank paper."""
    field = FlatField.measure(dark, white)
    before = _uneven(mean_image(white) - mean_image(dark), field)
    after = _held_out(dark, white, field)
    if after > MOST_UNEVEN:
        raise CalibrationError(
            f"blank paper is still uneven by {after:.1%} after correction, above "
            f"{MOST_UNEVEN:.0%}: use blank paper, hold it still, and take more images with --frames"
        )
    return OpticsFound(field, before, after)


def _held_out(dark: _Stack, white: _Stack, field: FlatField) -> float:
    """Return the unevenness of corrected white frames. If there are several, correct half of them
    with a flat field from the other half."""
    if min(len(dark), len(white)) > 1:
        field = FlatField.measure(dark[::2], white[::2])
        white = white[1::2]
    corrected = mean_image([field.correct(image) for image in white])
    return _uneven(corrected, field)


def _uneven(levels: NDArray[np.float64], field: FlatField) -> float:
    good = levels[field.gain > 0]
    return float(good.std() / good.mean())


Matrix = NDArray[np.floating[Any]]
Gray = NDArray[np.integer[Any] | np.floating[Any]]

MARKERS = 3  # number of markers in each row and column of the target
MODULES = 7 * MARKERS - 1  # squares across the target: 6 for each marker, 1 between two markers
FIELD_SHARE = 1.5  # side of the target divided by the shorter side of the field of view
FEWEST_PIXELS = 24  # fewest rows and columns of a sensor in which markers are recognized
LEAST_CORRELATION = 0.8  # least allowed correlation of image and target; a flat target has over 0.9
MOST_OUTSIDE = 0.25  # largest allowed share of electrodes outside the image
DOTS_PER_MM = 50  # resolution of the printed target
_SIZES_MM = (1.0, 200.0)
_MARGIN_MM = 8.0
_WORKING_SIDE = 240  # shorter side of the image in which markers are detected, pixels
_MODULE_PX = 12  # width of a module in `picture`, pixels
_QUIET = 2  # width of the white margin of `picture`, modules


@dataclass(frozen=True)
class PageTarget:
    """Square of ArUco markers on paper, to be centered under the array."""

    module_mm: float

    @property
    def side_mm(self) -> float:
        return MODULES * self.module_mm

    @property
    def to_mm(self) -> Matrix:
        """Homography, (3, 3), from pixels of `picture` to millimeters from its middle."""
        scale = self.module_mm / _MODULE_PX
        middle = (MODULES + 2 * _QUIET) / 2 * self.module_mm
        return np.array([[scale, 0, scale / 2 - middle], [0, scale, scale / 2 - middle], [0, 0, 1]])

    def draw(self, path: Path) -> None:
        """Write the target as a PNG file with its resolution, for printing at true size."""
        margin, side = round(_MARGIN_MM * DOTS_PER_MM), round(self.side_mm * DOTS_PER_MM)
        image = Image.new("L", (side + 2 * margin,) * 2, 255)
        image.paste(Image.fromarray(_board().generateImage((side, side))), (margin, margin))
        text = f"SmartTouch, this side up. Print at 100 %: the square is {self.side_mm:g} mm wide"
        pen, size = ImageDraw.Draw(image), 2.2 * DOTS_PER_MM
        while pen.textlength(text, font_size=size) > image.width - 2 * DOTS_PER_MM:
            size *= 0.9
        pen.text((DOTS_PER_MM, DOTS_PER_MM), text, fill=0, font_size=size)
        content = BytesIO()
        image.save(content, format="PNG", dpi=(25.4 * DOTS_PER_MM,) * 2)
        write_bytes(path, content.getvalue(), CalibrationError)


def target_for(profile: Profile) -> PageTarget:
    """Return a target whose side is `FIELD_SHARE` times the shorter side of the field of view."""
    optics = profile.optics
    if min(optics.sensor_columns, optics.sensor_rows) < FEWEST_PIXELS:
        raise CalibrationError(
            f"the profile's sensor has {optics.sensor_columns} × {optics.sensor_rows} pixels, but "
            f"a target needs at least {FEWEST_PIXELS} pixels a side: correct optics.sensor_columns "
            "and optics.sensor_rows if the sensor has more pixels, or set optics.rotation_deg, "
            "optics.offset_x_mm and optics.offset_y_mm by hand"
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
    """Return the gray levels of the target, with a white margin."""
    printed = _board().generateImage((MODULES * _MODULE_PX,) * 2)
    around = (_QUIET * _MODULE_PX,) * 4
    bordered = cv2.copyMakeBorder(printed, *around, cv2.BORDER_CONSTANT, value=255)
    return np.asarray(bordered, np.uint8)


def apply(homography: Matrix, points: Matrix) -> NDArray[np.float64]:
    """Map points, (N, 2), by a homography."""
    carried = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(carried[:, :2] / carried[:, 2:])


@dataclass(frozen=True, eq=False)
class RegistrationFound:
    """Registration of a sensor with the electrode array, and the quality of the fit."""

    # (3, 3): maps points on the page, mm from the array's middle, to pixels of the image
    homography: NDArray[np.float64]
    shape: tuple[int, int]  # rows and columns of the image
    electrode_pixel: NDArray[np.float64]  # (E, 2): column and row of the pixel under each electrode
    markers: int  # number of markers recognized
    correlation: float  # correlation of image and target; 1 if they are equal

    @property
    def outside(self) -> NDArray[np.intp]:
        """Electrodes outside the image."""
        rows, columns = self.shape
        x, y = self.electrode_pixel.T
        inside = (x >= -0.5) & (x <= columns - 0.5) & (y >= -0.5) & (y <= rows - 0.5)
        return np.flatnonzero(~inside)

    def sentence(self) -> str:
        """Return the sentence that the profile stores about this result."""
        return (
            f"{self.markers} markers in {self.shape[1]} × {self.shape[0]} pixels, correlation "
            f"{self.correlation:.3f}"
            + (f"; {len(self.outside)} electrodes lie outside the image" * bool(len(self.outside)))
        )


def register(image: NDArray[np.uint8], profile: Profile, target: PageTarget) -> RegistrationFound:
    """Register the sensor from an image, (H, W), of the printed target."""
    rows, columns = image.shape
    scale = _WORKING_SIDE / min(rows, columns)
    size = round(columns * scale), round(rows * scale)
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    working = cv2.resize(image, size, interpolation=method)
    mirror = np.eye(3)
    markers = _markers(working)
    if markers is None:
        mirror = np.array([[-1.0, 0, size[0] - 1], [0, 1, 0], [0, 0, 1]])
        working = np.ascontiguousarray(working[:, ::-1])
        markers = _markers(working)
    if markers is None:
        raise CalibrationError(
            "no marker of the target is recognized: lay the target under the sensor, light it, and "
            "bring it into focus"
        )
    to_working, correlation = _aligned(working, *markers)
    if not correlation >= LEAST_CORRELATION:
        raise CalibrationError(
            f"the image correlates with the target by {correlation:.2f}, less than "
            f"{LEAST_CORRELATION:g}: lay the target flat, bring more of it into view, and check "
            "the lens"
        )
    grown = np.array(
        [[1 / scale, 0, 0.5 / scale - 0.5], [0, 1 / scale, 0.5 / scale - 0.5], [0, 0, 1]]
    )
    homography = grown @ mirror @ to_working @ np.linalg.inv(target.to_mm)
    homography /= homography[2, 2]
    places_mm = profile.electrodes.position_mm / profile.optics.magnification
    registered = RegistrationFound(
        homography, (rows, columns), apply(homography, places_mm), len(markers[0]) // 4, correlation
    )  # fmt: skip
    _require_in_view(registered)
    return registered


def _markers(working: Gray) -> tuple[Matrix, Matrix] | None:
    """Return corners of markers, (N, 2), in modules and in pixels; None if there is no marker."""
    parameters = cv2.aruco.DetectorParameters()
    # In an enlarged image a module has up to 15 pixels, too many for the default window size.
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
    """Return the homography from pixels of `picture` to pixels of an image, and the correlation.

    The corners of markers give a first homography. Blur shifts corners, so a fit then maximizes the
    enhanced correlation coefficient of `picture` and image (Evangelidis and Psarakis 2008).
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
        # The fit diverges if the image does not show the target.
        return np.eye(3), 0.0
    return np.asarray(fitted, np.float64), float(correlation)


def _require_in_view(registration: RegistrationFound) -> None:
    count = len(registration.electrode_pixel)
    if len(registration.outside) > MOST_OUTSIDE * count:
        raise CalibrationError(
            f"{len(registration.outside)} of {count} electrodes lie outside the image: move the "
            "middle of the target under the middle of the array, or check optics.magnification"
        )
