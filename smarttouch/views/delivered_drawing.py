"""Pictures of what the skin received, below what the finger passed over: a page, or a mosaic of the
source's frames.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import write_bytes
from smarttouch.imaging.line_picture import Floats, Raster, as_ink
from smarttouch.kernels.bank import KernelBank
from smarttouch.pages.page_image import INCH_MM, Page
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import in_color
from smarttouch.profile import Optics, Profile
from smarttouch.running.delivered import (
    FIELD_MM,
    MOST_SLOTS,
    Counts,
    DeliveredResponses,
    delivered_spikes,
)
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Input, Pose

PIXEL_MM = 0.1
LARGEST_PIXELS = 40_000_000  # largest page; frames farther away are left out
_BLOCK = 256  # least growth of the canvas, in pixels


class Mosaic:
    """Average of frames at their poses; grows as the source moves."""

    def __init__(self, optics: Optics) -> None:
        self._optics = optics
        self._sum = np.zeros((0, 0), np.float32)
        self._count = np.zeros((0, 0), np.float32)
        self._first = self._end = np.zeros(2, np.intp)  # row and column, in pixels of a page
        self._number: int | None = None

    def add(self, given: Input) -> None:
        """Add an image, unless it is stale or was added before."""
        if given.number == self._number or given.stale or given.image is None:
            return
        self._number = given.number
        optics, pose = self._optics, given.pose
        # A warp samples points, so a frame finer than the page is averaged down first.
        wide, high = (
            round(each / PIXEL_MM) for each in (optics.field_width_mm, optics.field_height_mm)
        )
        image: NDArray[Any] = given.image
        if image.shape[1] > wide and image.shape[0] > high:
            image = cv2.resize(image, (wide, high), interpolation=cv2.INTER_AREA)
        height, width = image.shape
        turn = pose.angle_rad - math.radians(optics.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        half = math.hypot(optics.field_width_mm, optics.field_height_mm) / 2 / PIXEL_MM
        left, top = (math.floor(center / PIXEL_MM - half) for center in (pose.x_mm, pose.y_mm))
        side = 2 * math.ceil(half) + 2
        if not self._reach(top, left, side):
            return
        # Pixels of the frame become pixels of a tile of the page.
        scale_x = optics.field_width_mm / width / PIXEL_MM
        scale_y = optics.field_height_mm / height / PIXEL_MM
        turned = np.array([[cos * scale_x, -sin * scale_y], [sin * scale_x, cos * scale_y]])
        middle = np.array([pose.x_mm / PIXEL_MM - left, pose.y_mm / PIXEL_MM - top]) - 0.5
        shift = middle - turned @ [(width - 1) / 2, (height - 1) / 2]
        to_tile = np.column_stack([turned, shift])
        size = (side, side)
        tile = cv2.warpAffine(image, to_tile, size, borderMode=cv2.BORDER_REPLICATE)
        seen = cv2.warpAffine(np.ones_like(image), to_tile, size, flags=cv2.INTER_NEAREST)
        row, column = np.array([top, left]) - self._first
        place = (slice(row, row + side), slice(column, column + side))
        self._sum[place] += tile * seen
        self._count[place] += seen

    def _reach(self, top: int, left: int, side: int) -> bool:
        """Grow the canvas so that a tile lies on it; return whether it does."""
        start = np.array([top, left])
        if not self._sum.size:
            self._first = self._end = start
        first = np.where(start < self._first, np.minimum(start, self._first - _BLOCK), self._first)
        end = np.where(
            start + side > self._end, np.maximum(start + side, self._end + _BLOCK), self._end
        )
        if np.prod(end - first) > LARGEST_PIXELS:
            return False
        borders = np.column_stack([self._first - first, end - self._end])
        if borders.any():
            self._sum, self._count = (np.pad(each, borders) for each in (self._sum, self._count))
            self._first, self._end = first, end
        return True

    def page(self) -> tuple[Page, tuple[float, float]]:
        """Return the page and the place of its top left corner, (x, y) mm; raise if no frame was
        seen."""
        rows, columns = (np.flatnonzero(self._count.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            raise SmartTouchError("the source gave no images of a page: there is nothing to draw")
        area = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        count = self._count[area]
        paper = np.full_like(count, 226.0)
        grey: NDArray[np.float32] = np.divide(self._sum[area], count, out=paper, where=count > 0)
        top, left = (np.add(self._first, (rows[0], columns[0])) * PIXEL_MM).tolist()
        return Page(np.rint(grey).astype(np.uint8), PIXEL_MM), (left, top)


FINEST_MM = 0.1
_WIDTH = (900, 1400)  # pixels that a picture is drawn wide at least, and at most
_MARGIN, _LABEL = 24, 28
_DOT_PART = 0.8  # diameter of the dot that stands for an electrode, of its cell
_STOOD = 5  # sequences at a place, in the mean, of a finger that goes in steps
_SCALE_PART = 0.2  # largest part of a picture's width that its scale bar takes
_SCALES_MM = (100, 50, 20, 10, 5, 2, 1, 0.5)
Grey = NDArray[np.uint8]
Place = tuple[float, float]
Places = NDArray[np.floating]
Ink = int | tuple[int, int, int]
Under = tuple[str, Place, Place, Callable[[tuple[int, int], float], Grey] | None]
"""Title, top left corner, width and height in mm; and a function that draws it for a shape and a
pixel size in mm, None where there is nothing to see."""


_DARK_QUANTILE = 0.999
_SIDE_MM = 0.5  # distance of the places by which passes of the finger are counted


class SpikeMap:
    """Spikes where the receptors were, in the color of each class on white.

    ``placed`` returns where places of the finger are at a pose, (N, 2) mm from the picture's
    corner; ``field_mm`` is the standard deviation of a receptive field. With ``mean`` a place shows
    its spikes for each pass.
    """

    def __init__(
        self,
        finger: Finger,
        placed: Callable[[Places, Pose], Places],
        shape: tuple[int, int],
        pixel_mm: float,
        field_mm: float = FIELD_MM,
        *,
        mean: bool = True,
    ) -> None:
        self._finger, self._placed, self._mean = finger, placed, mean
        self._pixel_mm, self._sigma = pixel_mm, field_mm / pixel_mm
        self._spikes = np.zeros((len(Afferent), *shape), np.float32)
        self._passes = np.zeros(shape, np.float32)
        sides = [np.arange(-side, side, _SIDE_MM) + _SIDE_MM / 2 for side in finger.reach_mm]
        self._skin = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)

    def add(self, pose: Pose, counts: NDArray[np.intp]) -> None:
        """Add the spikes of each afferent, (A,), at a pose of the finger."""
        fired = np.flatnonzero(counts)
        row, column, on = self._pixels(self._finger.receptor_mm[fired], pose)
        classes = self._finger.classes[fired[on]]
        np.add.at(self._spikes, (classes, row, column), counts[fired[on]])
        row, column, _ = self._pixels(self._skin, pose)
        self._passes[row, column] += 1

    def image(self) -> NDArray[np.uint8]:
        """Return the map in color, (H, W, 3)."""
        spikes = self._spread()
        total = spikes.sum(axis=0)
        dark = float(np.quantile(total[total > 0], _DARK_QUANTILE)) if total.any() else 1.0
        return np.asarray(np.rint(255 * in_color(spikes, dark)), np.uint8)

    def _spread(self) -> NDArray[np.float32]:
        """Return spikes of each class, (3, H, W), blurred by receptive fields."""
        spread = np.stack([cv2.GaussianBlur(each, (0, 0), self._sigma) for each in self._spikes])
        if self._mean:
            wide = cv2.GaussianBlur(self._passes, (0, 0), self._sigma)
            spread = spread / np.maximum(wide, wide.max(initial=0) / 20 + 1e-9)
        return np.asarray(spread, np.float32)

    def _pixels(
        self, places_mm: Places, pose: Pose
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Return rows and columns of the places that are on the picture, and which these are."""
        shape = self._passes.shape
        column, row = np.floor(self._placed(places_mm, pose) / self._pixel_mm).astype(np.intp).T
        on = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        return row[on], column[on], on


class DeliveredDrawing(DeliveredResponses, ABC):
    """Delivered pulses at the electrodes' places, below what they touched. A place shows the mean
    response of the electrodes that passed it, or the strongest (see `DeliveredResponses`);
    ``magnification`` is mm of the array per mm touched."""

    strongest = False  # whether a place shows the strongest response, not the mean
    longest_px = 4000

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferents: tuple[Afferent, ...],
        magnification: float = 1.0,
    ) -> None:
        super().__init__(profile, bank, afferents)
        self._magnification = magnification
        self._position_mm = profile.electrodes.position_mm / magnification
        self._cell_mm = tuple(side / magnification for side in profile.electrodes.cell_mm)
        self._names = " and ".join(each.name for each in afferents)
        self._finger: Finger | None = None
        self.spikes: Counts = {}  # spikes of each afferent, (A,), by number of the sequence

    @abstractmethod
    def under(self) -> Under:
        """Return what was touched; raises if nothing was."""

    def deliver(
        self,
        numbers: NDArray[np.uint32],
        width_us: Floats,
        current_ua: NDArray[np.int16],
        finger: Finger | None = None,
    ) -> None:
        """Take delivered slots; with a finger its spikes are drawn, too."""
        super().deliver(numbers, width_us, current_ua)
        self._finger = finger
        if finger is not None:
            self.spikes = delivered_spikes(
                finger, numbers, width_us, current_ua, self.period_us, MOST_SLOTS
            )

    def places_mm(self, pose: Pose) -> NDArray[np.float64]:
        """Return where the electrodes are at a pose, (E, 2) mm."""
        return self.placed(self._position_mm, pose)

    def placed(self, places_mm: Places, pose: Pose) -> NDArray[np.float64]:
        """Return where places of the finger, (N, 2) mm on what it touches, are at a pose."""
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        x, y = places_mm.T
        return np.column_stack([pose.x_mm + x * cos - y * sin, pose.y_mm + x * sin + y * cos])

    def picture(self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float) -> Grey:
        """Return the touch of an area as grey levels, (H, W); 255 is nothing, 0 the strongest."""
        raster = Raster(shape, self.strongest)
        for pose, answer in self:
            place = self.places_mm(pose) - corner_mm
            pixel = place // pixel_mm if self.strongest else np.rint(place / pixel_mm)
            column, row = pixel.astype(np.intp).T
            raster.add(row, column, answer)
        wide, high = (max(1, round(side / pixel_mm)) for side in self._cell_mm)
        if self.strongest:
            cell = np.ones((high, wide), np.uint8)
            return as_ink(np.asarray(cv2.dilate(raster.value, cell), np.float32))
        if _STOOD * len(set(self.poses.values())) > len(self.poses):
            return as_ink(raster.mean(lambda each: np.asarray(cv2.blur(each, (wide, high)))))
        # Dots where the finger goes in steps, so that those of a Braille cell stand apart.
        sides = [max(1, round(_DOT_PART * each)) for each in (wide, high)]
        dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, sides).astype(np.float32)
        return as_ink(raster.mean(lambda each: np.asarray(cv2.filter2D(each, -1, dot))))

    def felt_picture(
        self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return the spikes of a finger where its receptors were, (H, W, 3)."""
        assert self._finger is not None
        scale = self._magnification
        felt = SpikeMap(
            self._finger,
            lambda places, pose: self.placed(places / scale, pose) - corner_mm,
            shape,
            pixel_mm,
            FIELD_MM / scale,
            mean=not self.strongest,
        )
        for number, counts in self.spikes.items():
            felt.add(self.poses[number], counts)
        return felt.image()

    def save(self, path: Path) -> None:
        """Write what was touched and the touch below it as one PNG in true size."""
        title, corner_mm, (width_mm, height_mm), draw_under = self.under()
        pixel_mm = max(FINEST_MM, max(width_mm, height_mm) / self.longest_px)
        height, width = round(height_mm / pixel_mm), round(width_mm / pixel_mm)
        area = (corner_mm, (height, width), pixel_mm)
        rows = [(f"Delivered: {self._names} pulses where the electrodes were", self.picture(*area))]
        finger = self._finger
        if finger is not None:
            words = (
                f"Felt by finger {finger.seed}, {finger.anatomy.name}: spikes where receptors were"
            )
            rows.append((words, self.felt_picture(*area)))
        if draw_under is not None:
            rows.insert(0, (title, draw_under((height, width), pixel_mm)))
        scale = min(max(1.0, _WIDTH[0] / width), _WIDTH[1] / width)
        size = (round(width * scale), round(height * scale))
        step = size[1] + _LABEL + _MARGIN
        sheet = Image.new(
            "L" if finger is None else "RGB",
            (size[0] + 2 * _MARGIN, len(rows) * step + _MARGIN),
            226 if finger is None else (226, 226, 226),
        )
        ink: Ink = 40 if finger is None else (40, 40, 40)
        draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
        for index, (title, image) in enumerate(rows):
            top = _MARGIN + index * step
            draw.text((_MARGIN, top), title, fill=ink, font=font)
            resized = Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)
            sheet.paste(resized, (_MARGIN, top + _LABEL))
        if finger is not None:
            _draw_classes(draw, font, (_MARGIN + size[0], _MARGIN + (len(rows) - 1) * step))
        per_mm = size[0] / width_mm
        _draw_scale(draw, font, (_MARGIN + size[0], _MARGIN), per_mm, ink, size[0])
        content = BytesIO()
        sheet.save(content, format="PNG", dpi=(per_mm * INCH_MM, per_mm * INCH_MM))
        write_bytes(path, content.getvalue())


def _draw_scale(
    draw: ImageDraw.ImageDraw,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    end: tuple[int, int],
    per_mm: float,
    ink: Ink,
    most: int,
) -> None:
    """Draw a bar of whole millimeters with its length, within a part of ``most`` pixels left of an
    end, (right, top)."""
    right, top = end
    length_mm = next((each for each in _SCALES_MM if each * per_mm <= _SCALE_PART * most), 0.5)
    left, middle = right - round(length_mm * per_mm), top + _LABEL // 2 - 2
    draw.rectangle((left, middle - 2, right - 1, middle + 1), fill=ink)
    draw.text((left - 8, middle), f"{length_mm:g} mm", fill=ink, font=font, anchor="rm")


def _draw_classes(
    draw: ImageDraw.ImageDraw,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    end: tuple[int, int],
) -> None:
    """Write the name of each class in its color, above the right end of a picture."""
    right, top = end
    for afferent, color in reversed(CLASS_COLORS.items()):
        draw.text((right, top), afferent.name, fill=color, font=font, anchor="ra")
        right -= round(draw.textlength(afferent.name, font=font)) + _LABEL // 2


class PageDrawing(DeliveredDrawing):
    """Shows the mean response at every place of a page, a mosaic of the frames if it is not
    given."""

    def __init__(
        self, profile: Profile, bank: KernelBank, afferents: tuple[Afferent, ...], page: Page | None
    ) -> None:
        super().__init__(profile, bank, afferents, profile.optics.magnification)
        self._page = page
        self._mosaic = Mosaic(profile.optics) if page is None else None
        self._seen = False

    def watch(self, sent: StepResult) -> None:
        """Record the pose of a step, and its frame if the page is not known."""
        super().watch(sent)
        if self._mosaic is not None and sent.number in self.poses:
            self._mosaic.add(sent.input)
            self._seen |= sent.input.image is not None

    def under(self) -> Under:
        """Return the whole page; if nothing was seen, the area that the electrodes touched."""
        title, page, corner_mm = "The page, as it lies under the finger", self._page, (0.0, 0.0)
        if self._mosaic is not None and not self._seen and self.poses:
            places_mm = np.concatenate([self.places_mm(each) for each in self.poses.values()])
            corner = places_mm.min(axis=0) - self._cell_mm
            wide, high = np.ptp(places_mm, axis=0) + 2 * np.array(self._cell_mm)
            return "", (float(corner[0]), float(corner[1])), (float(wide), float(high)), None
        if self._mosaic is not None:
            title = "The frames that passed under the finger, put together"
            page, corner_mm = self._mosaic.page()
        assert page is not None
        grey = page.grey
        return title, corner_mm, page.size_mm, lambda _shape, _pixel_mm: grey
