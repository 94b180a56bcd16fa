"""Pictures of what the skin got, below what it touched."""

from abc import ABC, abstractmethod
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.delivered.mosaic import Mosaic
from smarttouch.delivered.perception import DeliveredAnswers
from smarttouch.delivered.raster import Raster, as_ink
from smarttouch.documents.page_image import Page
from smarttouch.files import write_bytes
from smarttouch.kernels.bank import KernelBank
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.running.step import StepResult
from smarttouch.sources.frame import Pose

FINEST_MM = 0.1
"""Finest pixel of a picture, on what was touched."""
_WIDTH = (900, 1400)
"""Pixels that a picture is drawn wide at least, and at most."""
_MARGIN, _LABEL = 24, 28
Grey = NDArray[np.uint8]
Place = tuple[float, float]


class FeltDrawing(DeliveredAnswers, ABC):
    """Delivered pulses where the electrodes were, below what they touched.

    Every place shows the mean answer of the electrodes that passed it, or the strongest.

    Parameters
    ----------
    profile, bank, primaries
        See `Perception`.
    magnification : float
        Millimeters of the array for one of what it touches.
    """

    strongest = False
    longest_px = 4000

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        primaries: tuple[Primary, ...],
        magnification: float = 1.0,
    ) -> None:
        super().__init__(profile, bank, primaries)
        self._position_mm = profile.electrodes.position_mm / magnification
        self._cell_mm = tuple(side / magnification for side in profile.electrodes.cell_mm)
        self._names = " and ".join(each.name for each in primaries)

    @abstractmethod
    def area_mm(self) -> tuple[Place, Place]:
        """Return the top left corner of what was touched, and its width and height."""

    @abstractmethod
    def under(self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float) -> tuple[str, Grey]:
        """Return a title and a picture of an area of what was touched."""

    def places_mm(self, pose: Pose) -> NDArray[np.float64]:
        """Return where the electrodes are at a pose, (E, 2) mm."""
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        x, y = self._position_mm.T
        return np.column_stack([pose.x_mm + x * cos - y * sin, pose.y_mm + x * sin + y * cos])

    def picture(self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float) -> Grey:
        """Return the touch of an area as ink on paper, (H, W); 255 is nothing, 0 the strongest."""
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
        return as_ink(raster.mean(lambda each: np.asarray(cv2.blur(each, (wide, high)))))

    def save(self, path: Path) -> None:
        """Write what was touched with the touch below it as one PNG.

        Raises
        ------
        SmartTouchError
            If there is nothing to draw, or the file cannot be written.
        """
        corner_mm, (width_mm, height_mm) = self.area_mm()
        pixel_mm = max(FINEST_MM, max(width_mm, height_mm) / self.longest_px)
        height, width = round(height_mm / pixel_mm), round(width_mm / pixel_mm)
        area = (corner_mm, (height, width), pixel_mm)
        felt = (f"Felt: {self._names} pulses where the electrodes were", self.picture(*area))
        scale = min(max(1.0, _WIDTH[0] / width), _WIDTH[1] / width)
        size = (round(width * scale), round(height * scale))
        step = size[1] + _LABEL + _MARGIN
        sheet = Image.new("L", (size[0] + 2 * _MARGIN, 2 * step + _MARGIN), 226)
        draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
        for top, (title, image) in zip(
            (_MARGIN, _MARGIN + step), (self.under(*area), felt), strict=True
        ):
            draw.text((_MARGIN, top), title, fill=40, font=font)
            resized = Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)
            sheet.paste(resized, (_MARGIN, top + _LABEL))
        content = BytesIO()
        sheet.save(content, format="PNG")
        write_bytes(path, content.getvalue())


class PageDrawing(FeltDrawing):
    """Shows the mean answer at every place of a page.

    Parameters
    ----------
    profile, bank, primaries
        See `Perception`.
    page : Page, optional
        What the finger passed over; put together from the frames if not given.
    """

    def __init__(
        self, profile: Profile, bank: KernelBank, primaries: tuple[Primary, ...], page: Page | None
    ) -> None:
        super().__init__(profile, bank, primaries, profile.optics.magnification)
        self._page = page
        self._mosaic = Mosaic(profile.optics) if page is None else None

    def watch(self, sent: StepResult) -> None:
        """Remember the pose of a step, and the frame where the page is not known."""
        super().watch(sent)
        if self._mosaic is not None and sent.number in self.poses:
            self._mosaic.add(sent.frame)

    def area_mm(self) -> tuple[Place, Place]:
        """Return the whole page."""
        corner_mm = (0.0, 0.0)
        if self._mosaic is not None:
            self._page, corner_mm = self._mosaic.page()
        assert self._page is not None
        return corner_mm, self._page.size_mm

    def under(self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float) -> tuple[str, Grey]:
        """Return the page."""
        assert self._page is not None
        seen = "The page" if self._mosaic is None else "The frames, put together"
        return f"{seen}, as it lies under the finger", self._page.grey
