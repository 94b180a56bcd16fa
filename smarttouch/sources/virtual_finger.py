"""Virtual finger that moves over a page, and the frames of its optical sensor."""

import getpass
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import PageError, SourceError, require_within
from smarttouch.base.files import read_csv, read_text
from smarttouch.pages.document import Document, LockedError
from smarttouch.pages.ink import is_light_on_dark, separate_ink
from smarttouch.pages.page_and_lines import INCH_MM, Page, TextLine
from smarttouch.pages.prepared_page import LAID_FLAT, find_lines, print_text
from smarttouch.pages.straighten import find_sheet, flattened
from smarttouch.pages.text_documents import FileKind, file_kind, read_document_text, read_plain_text
from smarttouch.profile import Profile
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose, Sheet

Floats = NDArray[np.float64]

RETURN_MM_S = 200.0  # speed of the lifted finger to the next line
SETTLE_S = 0.75  # rest at the start of a line
LIFT_S = 0.15
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 500.0
_PRESS = 1.1  # force during reading, relative to the profile's full force
_STEP_MM = 2.0  # distance between points of a path, much smaller than the bends of lines
_COLUMNS = ("time_s", "x_mm", "y_mm", "angle_deg", "force_n")


class FingerPath(NamedTuple):
    """Path of a finger over a page."""

    table: Floats  # (5, N): time s, x mm, y mm, angle rad, force N
    lines: tuple[TextLine, ...] = ()  # lines of text that the path follows, if any

    @property
    def duration_s(self) -> float:
        return float(self.table[0, -1])


def reading_path(
    page: Page, profile: Profile, speed_mm_s: float, light_on_dark: bool = False
) -> FingerPath:
    """Return a path along the lines of a page, or along parallel strips if it has no lines."""
    require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
    field = (profile.optics.field_width_mm, profile.optics.field_height_mm)
    # Detect print that is lighter than the paper, even if the user has not declared it. Otherwise
    # the path would follow the dark gaps between the lines of text.
    lines = find_lines(page, light_on_dark or None) or [_printed(page, light_on_dark)]
    sweeps = tuple(sweep for line in lines for sweep in _sweeps(line, field[1]))
    rows: list[tuple[float, float, float, float, float]] = []
    time_s = 0.0
    for line in sweeps:
        x, y, angle, passed_mm = _middle_path(line, field[0])
        if rows:
            x_before, y_before = rows[-1][1:3]
            time_s += math.hypot(x[0] - x_before, y[0] - y_before) / RETURN_MM_S
        rows.append((time_s, x[0], y[0], angle[0], 0.0))
        rows.append((time_s + LIFT_S, x[0], y[0], angle[0], 1.0))
        sweep_at = time_s + SETTLE_S
        time_s = sweep_at + float(passed_mm[-1]) / speed_mm_s
        lifting_at = time_s - LIFT_S / 3
        passing = sweep_at + passed_mm / speed_mm_s
        times = np.sort(np.append(passing, lifting_at))
        places = (np.interp(times, passing, values) for values in (x, y, angle))
        press = np.interp(times, (lifting_at, time_s), (1.0, 0.0))
        rows.extend(zip(times, *places, press, strict=True))
    table = np.array(rows).T.copy()
    table[4] *= _PRESS * profile.force.full_n
    return FingerPath(table, sweeps)


def recorded_path(path: Path) -> FingerPath:
    """Load a path from a CSV file with columns time_s, x_mm, y_mm, angle_deg and force_n."""
    table = np.array([*read_csv(path, SourceError, _COLUMNS).values()])
    table[0] -= table[0, 0]
    table[3] = np.radians(table[3])
    return FingerPath(table)


def _printed(page: Page, light_on_dark: bool) -> TextLine:
    """Return the printed area of a page as one line, or the complete page if there is no print."""
    ink = separate_ink(page.grey, light_on_dark).ink
    x, y, width, height = cv2.boundingRect(ink.view(np.uint8))
    if not width:
        height, width = page.grey.shape
    left, right, top, bottom = np.multiply((x, x + width, y, y + height), page.mm_per_pixel)
    return TextLine(left, right, (bottom,), bottom - top, bottom - top, 0.0)


def _sweeps(line: TextLine, height_mm: float) -> list[TextLine]:
    """Divide a line that is taller than the sensor's field into parallel strips."""
    # A line may be up to 15 % taller than the field, for example with its ascenders.
    count = max(1, math.ceil(line.height_mm / height_mm - 0.15))
    step = line.height_mm / count
    return [
        replace(
            line,
            baseline=(line.baseline[0] - line.ascent_mm + (k + 1) * step, *line.baseline[1:]),
            ascent_mm=step,
            descent_mm=0.0,
        )
        for k in range(count)
    ]


def _middle_path(line: TextLine, field_mm: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Return x, y and angle of a finger along the middle of a line, and the distance covered."""
    # Begin on the first letters: on blank paper no current flows, so the ramp does not rise.
    start, end = line.left_mm, line.right_mm + field_mm / 2
    x = np.linspace(start, end, max(2, math.ceil((end - start) / _STEP_MM)))
    y = line.baseline_mm(x) + (line.descent_mm - line.ascent_mm) / 2
    passed_mm = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    return x, y, np.arctan(np.gradient(y, x)), passed_mm


OVERSAMPLING = 2  # samples per pixel and axis, averaged over the pixel's aperture
BLUR_MM = 0.06  # standard deviation of optical blur
NOISE_LEVELS = 2.0  # standard deviation of read noise, gray levels
USUAL_MM_S = 40.0
READER_MM_S = 7.0
"""Speed at which the 20 words of the sample page take 39 s: about 30 words a minute."""
AGAIN_S = 1.0  # pause of the lifted finger before it reads the page again
MOST_PASSES = 10_000
_SHADE = 0.1  # relative loss of light at the corners (vignetting)
_SLOPE = 0.03
_PRINT_MM, _USUAL_PRINT_MM = (1.5, 9.0), 3.7
"""Range of plausible line heights, and height of an 11-point line, all in mm from ascender to
descender. If the size of a page is assumed and its line height is outside the range, the page is
scaled until its lines have the height of 11-point lines."""
_CHOSEN_DPI = (97.0, 700.0)
"""A resolution in this range is trusted if a file states it. Outside the range, it is mostly a
default of the program that wrote the file, so it counts as an assumption."""
_MARGIN_MM = 4.0
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
    passes: int = 1,
    password_file: str | None = None,
) -> "PageSource":
    """Open ``page:FILE``, the first page of a document or image, for a virtual finger.

    The options are those of `load_or_guess`, `PageSource` and its method `repeat`. A sheet on a
    photograph is rectified. Ink is detected on the complete page, which is more reliable than in
    single frames."""
    notices: list[str] = []
    page, assumed = load_or_guess(Path(rest), dpi, page_width_mm, notices.append, password_file)
    if assumed:
        notices.append(assumed)
    if not light_on_dark and is_light_on_dark(page.grey):
        page = Page(np.asarray(255 - page.grey, np.uint8), page.mm_per_pixel)
        notices.append("the print is light on dark, and is shown dark on light")
    corners = None if path is not None or light_on_dark else find_sheet(page.grey)
    if corners is not None:
        flat = flattened(page.grey, corners)
        # A width that is given or assumed is the width of the sheet, not of the photograph.
        of_sheet = page_width_mm is not None or assumed
        page = Page(flat, page.size_mm[0] / flat.shape[1] if of_sheet else page.mm_per_pixel)
        notices.append(LAID_FLAT)
    cleaned = separate_ink(page.grey, light_on_dark).cleaned
    page = Page(255 - cleaned if light_on_dark else cleaned, page.mm_per_pixel)
    lines = find_lines(page, light_on_dark or None) if assumed else []
    print_mm = float(np.median([line.height_mm for line in lines])) if lines else _USUAL_PRINT_MM
    if not _PRINT_MM[0] < print_mm < _PRINT_MM[1]:
        page = Page(page.grey, page.mm_per_pixel * _USUAL_PRINT_MM / print_mm)
        scaled = f"the page is scaled to 11 points, {page.size_mm[0]:.0f} mm wide"
        notices.append(f"its print would be {print_mm:.1f} mm high: {scaled}")
    title, notice = Path(rest).name, "; ".join(notices)
    source = PageSource(page, profile, title, seed, speed_mm_s, path, light_on_dark, notice)
    source.repeat(passes)
    return source


def load_or_guess(
    path: Path,
    dpi: float | None,
    width_mm: float | None,
    note: Callable[[str], None],
    password_file: str | None = None,
) -> tuple[Page, str]:
    """Return the first page of a file, and a warning if its scale is guessed or doubtful.

    A text file is drawn as a printed page; ``note`` is called with warnings about omitted parts.
    """
    kind = file_kind(path) if path.is_file() else None
    if kind is FileKind.STRUCTURED:
        return print_text(read_document_text(path, note)), ""
    text = kind is FileKind.TEXT and path.suffix.lower() == ".txt"
    if text and dpi is None and width_mm is None:
        return print_text(read_plain_text(path).strip()), ""
    password = password_of(path, password_file)
    with Document(path, dpi=dpi, page_width_mm=width_mm, password=password) as document:
        page = document.page(0)
    if dpi or width_mm or page.lines:
        return page, ""
    notes, stated_dpi = document.notes, INCH_MM / page.mm_per_pixel
    if not notes and not _CHOSEN_DPI[0] < stated_dpi < _CHOSEN_DPI[1]:
        notes = [f"{path} states {stated_dpi:.0f} dots per inch"]
    return page, f"{notes[-1]}; give dpi or page_width_mm if you know it" if notes else ""


def password_of(path: Path, password_file: str | None = None) -> str | None:
    """Return the password of a document, or None if it needs none.

    Read the first line of ``password_file``, or of standard input for ``-``. Without a file, ask at
    the terminal."""
    if password_file is None:
        try:
            Document(path).close()
        except LockedError:
            if not sys.stdin.isatty():
                raise
            return getpass.getpass(f"Password of {path.name}: ")
        return None
    text = (
        sys.stdin.readline() if password_file == "-"
        else read_text(Path(password_file), PageError, 4096)
    )  # fmt: skip
    if password := text.partition("\n")[0].rstrip("\r"):
        return password
    raise PageError(f"no password in the first line of {password_file}: write it there")


def open_text(
    rest: str,
    profile: Profile,
    *,
    seed: int = 0,
    speed_mm_s: float = USUAL_MM_S,
    path: Path | None = None,
    light_on_dark: bool = False,
    passes: int = 1,
) -> "PageSource":
    """Open ``text:STRING``, a page on which the text is printed, for a virtual finger."""
    page = print_text(rest)
    source = PageSource(page, profile, "printed text", seed, speed_mm_s, path, light_on_dark)
    source.text = rest
    source.repeat(passes)
    return source


class PageSource(OpticalSource):
    """Frames of a virtual finger that reads a page line by line, or moves along a recorded path.

    ``seed`` determines the noise of the sensor. Frames do not depend on the order of reads.
    """

    ended = "end of the page"
    frames: int
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
        self.text: str = ""  # text of the page, if known
        self.notes: list[str] = [notice] if notice else []
        self.path: FingerPath = (
            reading_path(page, profile, speed_mm_s, light_on_dark)
            if path is None
            else recorded_path(path)
        )
        self._lasts_s = self.path.duration_s
        self.duration_s: float | None = self._lasts_s
        self._seed = seed
        optics = profile.optics
        self._shape = (optics.sensor_rows, optics.sensor_columns)
        fine = (self._shape[0] * OVERSAMPLING, self._shape[1] * OVERSAMPLING)
        pixel_mm = optics.field_width_mm / fine[1], optics.field_height_mm / fine[0]
        self._surface, self._surface_mm, self._margin = _surface(page, min(pixel_mm))
        self._step = pixel_mm[0] / self._surface_mm, pixel_mm[1] / self._surface_mm
        self._fine = np.empty(fine, np.uint8)
        self._coarse = np.empty(self._shape, np.uint8)
        self._light = _light(self._shape)

    @property
    def sheet(self) -> Sheet:
        """Return the page."""
        return Sheet(0, self.page)

    @property
    def words(self) -> str:
        """Return the text of the page, if known."""
        return self.text

    def repeat(self, passes: int) -> None:
        """Set the number of times that the finger reads the page; 0 means endlessly."""
        require_within(SourceError, "passes", passes, 0, MOST_PASSES)
        lasts_s = self._lasts_s
        self.duration_s = (passes - 1) * (lasts_s + AGAIN_S) + lasts_s if passes else None

    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start of the run; None after the last pass."""
        if self.duration_s is not None and time_ns / 1e9 > self.duration_s:
            return None
        time_s, lasts_s = time_ns / 1e9, self._lasts_s
        again_s = time_s % (lasts_s + AGAIN_S) if time_s > lasts_s else time_s
        at_s, table = min(again_s, lasts_s), self.path.table
        *place, force_n = map(float, map(partial(np.interp, at_s, table[0]), table[1:]))
        pose = Pose(*place)
        if again_s > lasts_s:
            # The finger is lifted between two passes over the page.
            force_n = 0.0
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        step_x, step_y = self._step
        rows, columns = self._fine.shape
        to_page = np.array([
            [cos * step_x, -sin * step_y, pose.x_mm / self._surface_mm + self._margin - 0.5],
            [sin * step_x, cos * step_y, pose.y_mm / self._surface_mm + self._margin - 0.5],
        ])  # fmt: skip
        to_page[:, 2] -= to_page[:, :2] @ [(columns - 1) / 2, (rows - 1) / 2]
        cv2.warpAffine(
            self._surface, to_page, (columns, rows), dst=self._fine,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        cv2.resize(self._fine, self._shape[::-1], dst=self._coarse, interpolation=cv2.INTER_AREA)
        random = np.random.default_rng((self._seed & 0xFFFFFFFF, time_ns))
        lit = random.standard_normal(self._shape, np.float32)
        lit *= NOISE_LEVELS
        lit += self._coarse * self._light
        image = np.clip(np.rint(lit, out=lit), 0, 255).astype(np.uint8)
        self.frames += 1
        return Frame(image, time_ns, pose, force_n, number=self.frames - 1)


def _surface(page: Page, finest_mm: float) -> tuple[NDArray[np.uint8], float, int]:
    """Return the page as the optics blur it, its scale (mm per pixel) and its margin (pixels)."""
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
    # The margin has the median gray of the page's edges.
    edges = np.concatenate([surface[0], surface[-1], surface[:, 0], surface[:, -1]])
    margin, paper = round(_MARGIN_MM / surface_mm), float(np.median(edges))
    whole = cv2.copyMakeBorder(surface, *4 * (margin,), cv2.BORDER_CONSTANT, value=paper)
    return np.asarray(whole, np.uint8), surface_mm, margin


def _light(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the illumination of each pixel: vignetting and a gradient, fixed to the sensor."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    return np.asarray(0.97 - _SHADE / 2 * (x * x + y * y) + _SLOPE * x, np.float32)
