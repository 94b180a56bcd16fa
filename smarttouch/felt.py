"""What the skin felt, drawn beside the page that the finger passed over."""

from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.documents.page_image import Page
from smarttouch.files import write_bytes
from smarttouch.kernels.bank import KernelBank
from smarttouch.mosaic import Mosaic
from smarttouch.perception import Perception
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.running.step import StepResult
from smarttouch.sources.frame import Pose

FINEST_MM = 0.1
"""Finest dot of the picture, on the page."""
_SHEET = (900, 1400)
"""Pixels that a picture is drawn wide at least, and at most."""


class FeltImage:
    """Puts delivered pulses back together at the finger poses of their frames.

    At every place of the page the picture shows the mean answer (`Perception`)
    over the electrodes that passed it.

    Parameters
    ----------
    profile : Profile
        Array, thresholds and magnification.
    bank : KernelBank
        Its kernels and receptors.
    primaries : tuple of Primary
        Whose receptors are asked; of several the one that answers most counts.
    page : Page, optional
        What the finger passed over; put together from the images if not given, bare
        where there are none.
    """

    def __init__(
        self, profile: Profile, bank: KernelBank, primaries: tuple[Primary, ...], page: Page | None
    ) -> None:
        self._given, self._primaries = page, primaries
        self._perception = Perception(profile, bank, primaries)
        self._mosaic = Mosaic(profile.optics)
        electrodes, magnification = profile.electrodes, profile.optics.magnification
        self._position_mm = electrodes.position_mm / magnification
        self._cell_mm = tuple(side / magnification for side in electrodes.cell_mm)
        self._poses: dict[int, Pose] = {}
        self._seen = page is not None

    def watch(self, sent: StepResult) -> None:
        """Remember where the finger was for a sequence, if it touched."""
        if sent.number is not None and sent.step.sequence.intensity > 0:
            self._poses[sent.number] = sent.step.input.pose
            if self._given is None:
                self._mosaic.add(sent.step.input)
                self._seen |= sent.step.input.image is not None

    def deliver(
        self,
        numbers: NDArray[np.uint32],
        width_us: NDArray[np.float32],
        current_ua: NDArray[np.int16],
    ) -> None:
        """Add delivered slots, as `Perception.answers` takes them."""
        self._lay_out()
        by_number = self._perception.answers(numbers, width_us, current_ua)
        silent = np.zeros(len(self._position_mm), np.float32)
        for number, pose in self._poses.items():
            self._add(pose, by_number.get(number, silent))

    def _lay_out(self) -> None:
        """Make room for the touch, beside the page."""
        if self._given is not None:
            self._page, self._corner_mm = self._given, (0.0, 0.0)
        elif self._seen or not self._poses:
            self._page, self._corner_mm = self._mosaic.page()
        else:
            self._page, self._corner_mm = self._bare()
        width_mm, height_mm = self._page.size_mm
        self._pixel_mm = max(FINEST_MM, max(width_mm, height_mm) / 4000)
        shape = (round(height_mm / self._pixel_mm), round(width_mm / self._pixel_mm))
        self._touch = np.zeros(shape, np.float32)
        self._passes = np.zeros(shape, np.float32)

    def _bare(self) -> tuple[Page, tuple[float, float]]:
        """Return paper as large as what all electrodes touched, and where its corner is."""
        place_mm = np.array([(each.x_mm, each.y_mm) for each in self._poses.values()])
        reach_mm = np.hypot(*self._position_mm.T).max() + max(self._cell_mm) / 2
        corner_mm = place_mm.min(axis=0) - reach_mm
        columns, rows = np.ceil((np.ptp(place_mm, axis=0) + 2 * reach_mm) / FINEST_MM).astype(int)
        paper = np.full((rows, columns), 255, np.uint8)
        return Page(paper, FINEST_MM), (float(corner_mm[0]), float(corner_mm[1]))

    def _add(self, pose: Pose, answer: NDArray[np.float32]) -> None:
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        x, y = self._position_mm[:, 0], self._position_mm[:, 1]
        left, top = pose.x_mm - self._corner_mm[0], pose.y_mm - self._corner_mm[1]
        column = np.rint((left + x * cos - y * sin) / self._pixel_mm).astype(np.intp)
        row = np.rint((top + x * sin + y * cos) / self._pixel_mm).astype(np.intp)
        rows, columns = self._touch.shape
        on = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        np.add.at(self._touch, (row[on], column[on]), answer[on])
        np.add.at(self._passes, (row[on], column[on]), 1)

    def picture(self) -> NDArray[np.uint8]:
        """Return the touch as ink on paper, (H, W) uint8; 255 is nothing, 0 the strongest."""
        kernel = [max(1, round(side / self._pixel_mm)) for side in self._cell_mm]
        touch = cv2.blur(self._touch, kernel)
        passes = cv2.blur(self._passes, kernel)
        mean = np.divide(touch, passes, out=np.zeros_like(touch), where=passes > 1e-6)
        return np.asarray(np.rint(255 * (1 - np.clip(mean, 0, 1))), np.uint8)

    def save(self, path: Path) -> None:
        """Write the page with the touch below it as one PNG.

        Raises
        ------
        SmartTouchError
            If the file cannot be written.
        """
        what = "The page, as it lies under the finger"
        if self._given is None:
            what = "What passed under the finger, put together"
        names = " and ".join(each.name for each in self._primaries)
        got = (self.picture(), f"What the skin got: {names} pulses where the finger was")
        write_sheet(path, (((self._page.grey, what),) if self._seen else ()) + (got,))


def write_sheet(path: Path, rows: tuple[tuple[NDArray[np.uint8], str], ...]) -> None:
    """Write pictures of one size below each other, each under its title, as one PNG.

    Raises
    ------
    SmartTouchError
        If the file cannot be written.
    """
    height, width = rows[0][0].shape
    scale = min(max(1.0, _SHEET[0] / width), _SHEET[1] / width)
    size = (round(width * scale), round(height * scale))
    margin, label = 24, 28
    step = size[1] + label + margin
    sheet = Image.new("L", (size[0] + 2 * margin, len(rows) * step + margin), 226)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
    for index, (image, text) in enumerate(rows):
        top = margin + index * step
        draw.text((margin, top), text, fill=40, font=font)
        resized = Image.fromarray(image).resize(size, Image.Resampling.LANCZOS)
        sheet.paste(resized, (margin, top + label))
    content = BytesIO()
    sheet.save(content, format="PNG")
    write_bytes(path, content.getvalue())
