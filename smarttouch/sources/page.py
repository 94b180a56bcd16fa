"""A virtual finger over a page: frames like those of a photo-sensor patch."""

import math
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.documents.document import open_document
from smarttouch.documents.page_image import Page, load_page
from smarttouch.documents.printed_text import print_text
from smarttouch.documents.text_lines import find_lines
from smarttouch.errors import PageError, UnknownSizeError
from smarttouch.profile import Profile
from smarttouch.sources.frame import Frame
from smarttouch.sources.reading_path import Path2D, ReadingPath, RecordedPath
from smarttouch.sources.source import OpticalSource

OVERSAMPLING = 2
"""Samples per pixel and axis; their mean is the pixel's aperture."""
BLUR_MM = 0.06
"""Standard deviation of the optics' blur."""
NOISE_LEVELS = 2.0
"""Standard deviation of the read noise, in grey levels."""
USUAL_MM_S = 40.0
LEAST_MAGNIFIED, MOST_MAGNIFIED = 0.1, 10.0
"""Range of the magnification of a page beyond the profile's."""
_SHADE = 0.1  # relative loss of light at the corners of the patch
_SLOPE = 0.03
_MARGIN_MM = 4.0
_MARGIN_BLUR_MM = 1.0  # blur of the paper beyond the page's edges, which removes the page's texture
_MOST_PIXELS = 60_000_000


def open_page(
    rest: str,
    profile: Profile,
    *,
    dpi: float | None = None,
    page_width_mm: float | None = None,
    seed: int = 0,
    speed_mm_s: float = USUAL_MM_S,
    path: Path | None = None,
    light_on_dark: bool = False,
    magnify: str = "1",
) -> "PageSource":
    """Open ``page:FILE``; options are those of `PageSource`, its scale, and its magnification.

    The page is magnified beyond the profile's scale; ``auto`` makes its usual lines fill the
    array.
    """
    page, notice = load_or_guess(Path(rest), dpi, page_width_mm)
    factor = _magnification(magnify, page, profile, light_on_dark)
    if factor != 1:
        page = Page(page.grey, page.mm_per_pixel * factor)
        notice = f"{notice + '; ' if notice else ''}it is magnified {factor:.3g} times"
    title = Path(rest).name
    return PageSource(page, profile, title, seed, speed_mm_s, path, light_on_dark, notice)


def _magnification(text: str, page: Page, profile: Profile, light_on_dark: bool) -> float:
    """Return a factor as given, or the one by which the usual lines of a page fill the array."""
    if text != "auto":
        try:
            factor = float(text)
        except ValueError:
            factor = math.nan
        if not LEAST_MAGNIFIED <= factor <= MOST_MAGNIFIED:
            raise PageError(
                f"magnify {text} is not possible: give auto, or a number from "
                f"{LEAST_MAGNIFIED:g} to {MOST_MAGNIFIED:g}",
                about="magnify",
            )
        return factor
    lines = find_lines(page, light_on_dark)
    if not lines:
        return 1.0
    # Long lines are the text; headings are larger.
    length = [line.right_mm - line.left_mm for line in lines]
    height = [line.height_mm for line in lines]
    order = np.argsort(height)
    total = np.cumsum(np.array(length)[order])
    usual_mm = height[order[np.searchsorted(total, total[-1] / 2)]]
    seen_mm = profile.electrodes.extent_mm[1] / profile.optics.magnification
    return float(np.clip(seen_mm / usual_mm, LEAST_MAGNIFIED, MOST_MAGNIFIED))


def load_or_guess(path: Path, dpi: float | None, width_mm: float | None) -> tuple[Page, str]:
    """Return a page, and a sentence if its scale is guessed; empty if it is known."""
    try:
        return load_page(path, dpi=dpi, page_width_mm=width_mm), ""
    except UnknownSizeError:
        pass
    with open_document(path) as document:
        return document.page(0), f"{document.notes[-1]}; give dpi or page_width_mm if you know it"


def open_text(
    rest: str,
    profile: Profile,
    *,
    seed: int = 0,
    speed_mm_s: float = USUAL_MM_S,
    path: Path | None = None,
    light_on_dark: bool = False,
) -> "PageSource":
    """Open ``text:STRING``, a page printed from a text."""
    page = print_text(rest)
    return PageSource(page, profile, "printed text", seed, speed_mm_s, path, light_on_dark)


class PageSource(OpticalSource):
    """Frames of a finger that moves over a page line by line, or along a recorded path.

    The seed is that of noise and force: the same one gives the same frames, in whatever order they
    are read.
    """

    ended = "end of the page"
    knows_force = True

    def __init__(
        self,
        page: Page,
        profile: Profile,
        title: str,
        seed: int = 0,
        speed_mm_s: float = USUAL_MM_S,
        path: Path | None = None,
        light_on_dark: bool = False,
        notice: str = "",
    ) -> None:
        super().__init__(title)
        self.page = page
        self.notes = [notice] if notice else []
        self.path: Path2D = (
            ReadingPath(page, profile, speed_mm_s, seed, light_on_dark)
            if path is None
            else RecordedPath(path)
        )
        self.duration_s = self.path.duration_s
        self._seed = seed
        optics = profile.optics
        self._shape = (optics.sensor_rows, optics.sensor_columns)
        pixel_mm = (
            optics.field_width_mm / optics.sensor_columns / OVERSAMPLING,
            optics.field_height_mm / optics.sensor_rows / OVERSAMPLING,
        )
        self._surface, self._surface_mm, self._margin = _surface(page, min(pixel_mm))
        self._step = pixel_mm[0] / self._surface_mm, pixel_mm[1] / self._surface_mm
        fine = (self._shape[0] * OVERSAMPLING, self._shape[1] * OVERSAMPLING)
        self._fine = np.empty(fine, np.uint8)
        self._coarse = np.empty(self._shape, np.uint8)
        self._light = _light(self._shape)

    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at a time since the start; None when the path is over."""
        if time_ns / 1e9 > self.path.duration_s:
            return None
        pose, force_n = self.path.at(time_ns / 1e9)
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        step_x, step_y = self._step
        rows, columns = self._fine.shape
        to_page = np.array(
            [
                [cos * step_x, -sin * step_y, pose.x_mm / self._surface_mm + self._margin - 0.5],
                [sin * step_x, cos * step_y, pose.y_mm / self._surface_mm + self._margin - 0.5],
            ]
        )
        to_page[:, 2] -= to_page[:, :2] @ [(columns - 1) / 2, (rows - 1) / 2]
        cv2.warpAffine(
            self._surface,
            to_page,
            (columns, rows),
            dst=self._fine,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        cv2.resize(self._fine, self._shape[::-1], dst=self._coarse, interpolation=cv2.INTER_AREA)
        random = np.random.default_rng((self._seed & 0xFFFFFFFF, time_ns))
        lit = random.standard_normal(self._shape, np.float32)
        lit *= NOISE_LEVELS
        lit += self._coarse * self._light
        image = np.clip(np.rint(lit, out=lit), 0, 255).astype(np.uint8)
        self.frames += 1
        return Frame(image, time_ns, pose, force_n, number=self.frames - 1)


def _surface(page: Page, finest_mm: float) -> tuple[NDArray[np.uint8], float, int]:
    """Return the page blurred by the optics, its scale, and the margin around it."""
    height, width = page.grey.shape
    scale = page.mm_per_pixel / finest_mm
    scale = min(scale, np.sqrt(_MOST_PIXELS / (height * width)))
    size = (max(2, round(width * scale)), max(2, round(height * scale)))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    surface = np.asarray(cv2.resize(page.grey, size, interpolation=method), np.uint8)
    surface_mm = page.mm_per_pixel * width / size[0]
    surface = np.asarray(
        cv2.GaussianBlur(surface, (0, 0), BLUR_MM / surface_mm, borderType=cv2.BORDER_REPLICATE),
        np.uint8,
    )
    # The paper continues beyond its edges, in its grey there.
    margin, soft = round(_MARGIN_MM / surface_mm), _MARGIN_BLUR_MM / surface_mm
    whole = np.pad(surface, margin)
    whole[:margin] = np.pad(_soft_edge(surface, soft), margin, mode="edge")
    whole[-margin:] = np.pad(_soft_edge(surface[::-1], soft), margin, mode="edge")
    whole[margin:-margin, :margin] = _soft_edge(surface.T, soft)[:, None]
    whole[margin:-margin, -margin:] = _soft_edge(surface.T[::-1], soft)[:, None]
    return whole, surface_mm, margin


def _soft_edge(grey: NDArray[np.uint8], sigma: float) -> NDArray[np.uint8]:
    """Return the first row of an image as it would be if all of it were blurred."""
    reach = math.ceil(3 * sigma)
    weights = cv2.getGaussianKernel(2 * reach + 1, sigma)[:, 0]
    # The first and last rows are repeated beyond the edges.
    rows = np.arange(-reach, reach + 1).clip(0, len(grey) - 1)
    soft = np.convolve(np.pad(weights @ grey[rows], reach, mode="edge"), weights, "valid")
    return np.rint(soft).astype(np.uint8)


def _light(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the light on each pixel: a vignette and a slope, fixed to the sensor."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    return np.asarray(0.97 - _SHADE / 2 * (x * x + y * y) + _SLOPE * x, np.float32)
