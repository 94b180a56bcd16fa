"""Pictures that show the page under a finger and, below the page, the delivered pulses."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.base.errors import DesignError, SmartTouchError
from smarttouch.base.files import write_bytes
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.imaging.image_reconstruction import Floats, Raster, as_ink
from smarttouch.kernels.bank import KernelBank
from smarttouch.pages.page_and_lines import INCH_MM
from smarttouch.physiology.afferent_anatomy import load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import FIELD_MM, MOST_SLOTS, Counts, delivered_spikes, in_color
from smarttouch.profile import Profile
from smarttouch.running.step_records import Listener, RunContext, StepResult
from smarttouch.sources.source_contract import Pose, Sheet

FINEST_MM = 0.1
_WIDTH = (900, 1400)  # smallest and largest width of a picture, pixels
_MARGIN, _LABEL = 24, 28
_DOT_PART = 0.8  # diameter of an electrode's dot, relative to the electrode's cell
_STEPWISE_FROM = 5  # smallest mean number of sequences at each pose, if the finger moves in steps
_SCALE_PART = 0.2  # largest width of the scale bar, relative to the picture
_SCALES_MM = (100, 50, 20, 10, 5, 2, 1, 0.5)
Grey = NDArray[np.uint8]
Place = tuple[float, float]
Places = NDArray[np.floating]
Ink = int | tuple[int, int, int]
Under = tuple[str, Place, Place, Callable[[tuple[int, int], float], Grey] | None]
"""Title of a picture; top left corner of the touched area, mm; size of this area, mm; and a
function that draws it from a shape in pixels and a pixel size in mm. None omits the picture."""


_DARK_QUANTILE = 0.999
_SIDE_MM = 0.5  # spacing of skin points that mark where the finger has been


class SpikeMap:
    """Picture of spikes on white. Each spike is at its receptor, in the color of its class.

    ``placed`` takes points on the finger and a pose. It returns points on the picture, (N, 2) mm
    from its corner. Spikes are blurred with the standard deviation ``field_mm``. With ``mean``, the
    spikes at a point are averaged over all poses in which the finger covered the point.
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
        """Add the spike counts of all afferents, (A,), at a pose of the finger."""
        fired = np.flatnonzero(counts)
        row, column, on = self._pixels(self._finger.receptor_mm[fired], pose)
        classes = self._finger.classes[fired[on]]
        np.add.at(self._spikes, (classes, row, column), counts[fired[on]])
        row, column, _ = self._pixels(self._skin, pose)
        self._passes[row, column] += 1

    def image(self) -> NDArray[np.uint8]:
        """Return the picture in RGB, (H, W, 3)."""
        spikes = self._spread()
        total = spikes.sum(axis=0)
        dark = float(np.quantile(total[total > 0], _DARK_QUANTILE)) if total.any() else 1.0
        return np.asarray(np.rint(255 * in_color(spikes, dark)), np.uint8)

    def _spread(self) -> NDArray[np.float32]:
        """Return the spikes of each class, (3, H, W), blurred by the receptive field."""
        spread = np.stack(
            [cv2.GaussianBlur(class_spikes, (0, 0), self._sigma) for class_spikes in self._spikes]
        )
        if self._mean:
            wide = cv2.GaussianBlur(self._passes, (0, 0), self._sigma)
            spread = spread / np.maximum(wide, wide.max(initial=0) / 20 + 1e-9)
        return np.asarray(spread, np.float32)

    def _pixels(
        self, places_mm: Places, pose: Pose
    ) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """Return the rows and columns of points on the picture, and the mask of these points."""
        shape = self._passes.shape
        column, row = np.floor(self._placed(places_mm, pose) / self._pixel_mm).astype(np.intp).T
        on = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        return row[on], column[on], on


class DeliveredDrawing(ABC):
    """Picture of delivered pulses at the positions of the electrodes, drawn below the page. Pixels
    show responses (see `KernelBank.responses`): the mean or the strongest response of all
    electrodes that passed over a pixel. ``magnification`` is mm on the array per mm on the page."""

    strongest = False  # whether a pixel shows the strongest response instead of the mean
    longest_px = 4000

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferents: tuple[Afferent, ...],
        magnification: float = 1.0,
    ) -> None:
        self.poses: dict[int, Pose] = {}  # by sequence number, only of sequences with current
        self._period_us: dict[int, int] = {}
        self.answers: dict[int, Floats] = {}  # by sequence number: (E,) responses from 0 to 1
        self._respond = partial(bank.responses, profile, afferents)
        self._magnification = magnification
        self._position_mm = profile.electrodes.position_mm / magnification
        self._cell_mm = tuple(side / magnification for side in profile.electrodes.cell_mm)
        self._names = " and ".join(afferent.name for afferent in afferents)
        self._finger: Finger | None = None
        self.spikes: Counts = {}  # spikes of each afferent, (A,), by sequence number

    @abstractmethod
    def under(self) -> Under:
        """Describe the touched area. Raises SmartTouchError if nothing was touched."""

    def watch(self, sent: StepResult) -> None:
        """If a scan sequence was sent with current, record its period and the finger's pose."""
        if sent.number is not None and sent.sequence.intensity > 0:
            self.poses[sent.number] = sent.input.pose
            self._period_us[sent.number] = sent.sequence.period_us

    def deliver(
        self,
        numbers: NDArray[np.uint32],
        width_us: Floats,
        current_ua: NDArray[np.int16],
        finger: Finger | None = None,
    ) -> None:
        """Compute the responses to delivered slots and, with ``finger``, the finger's spikes."""
        self.answers = self._respond(numbers, width_us, current_ua)
        self._finger = finger
        if finger is not None:
            self.spikes = delivered_spikes(
                finger, numbers, width_us, current_ua, self._period_us, MOST_SLOTS
            )

    def places_mm(self, pose: Pose) -> NDArray[np.float64]:
        """Return the positions of the electrodes on the page at a pose, (E, 2) mm."""
        return self.placed(self._position_mm, pose)

    def placed(self, places_mm: Places, pose: Pose) -> NDArray[np.float64]:
        """Map points of the finger, (N, 2) mm, to points of the page at a pose."""
        cos, sin = np.cos(pose.angle_rad), np.sin(pose.angle_rad)
        x, y = places_mm.T
        return np.column_stack([pose.x_mm + x * cos - y * sin, pose.y_mm + x * sin + y * cos])

    def picture(self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float) -> Grey:
        """Return the responses in an area as gray levels, (H, W): 255 is none, 0 the strongest."""
        raster = Raster(shape, self.strongest)
        silent = np.zeros(len(self._position_mm), np.float32)
        for number, pose in self.poses.items():
            position_mm = self.places_mm(pose) - corner_mm
            pixel = position_mm // pixel_mm if self.strongest else np.rint(position_mm / pixel_mm)
            column, row = pixel.astype(np.intp).T
            raster.add(row, column, self.answers.get(number, silent))
        wide, high = (max(1, round(side / pixel_mm)) for side in self._cell_mm)
        if self.strongest:
            cell = np.ones((high, wide), np.uint8)
            return as_ink(np.asarray(cv2.dilate(raster.value, cell), np.float32))
        if _STEPWISE_FROM * len(set(self.poses.values())) > len(self.poses):
            return as_ink(
                raster.mean(lambda raster_plane: np.asarray(cv2.blur(raster_plane, (wide, high))))
            )
        # The finger moves in steps. Draw small round dots, so that Braille dots do not merge.
        sides = [max(1, round(_DOT_PART * side)) for side in (wide, high)]
        dot = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, sides).astype(np.float32)
        return as_ink(
            raster.mean(lambda raster_plane: np.asarray(cv2.filter2D(raster_plane, -1, dot)))
        )

    def felt_picture(
        self, corner_mm: Place, shape: tuple[int, int], pixel_mm: float
    ) -> NDArray[np.uint8]:
        """Return the picture of the finger's spikes in RGB, (H, W, 3)."""
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
        """Write one PNG in true size: the page, below it the pulses and the finger's spikes."""
        title, corner_mm, (width_mm, height_mm), draw_under = self.under()
        pixel_mm = max(FINEST_MM, max(width_mm, height_mm) / self.longest_px)
        height, width = round(height_mm / pixel_mm), round(width_mm / pixel_mm)
        area = (corner_mm, (height, width), pixel_mm)
        rows = [(f"Delivered: {self._names} pulses, each at its electrode", self.picture(*area))]
        finger = self._finger
        if finger is not None:
            words = (
                f"Felt by finger {finger.seed}, {finger.anatomy.name}: spikes, each at its receptor"
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
    """Draw a scale bar and, left of it, its length. ``end`` is the top right corner of the bar."""
    right, top = end
    length_mm = next(
        (scale_mm for scale_mm in _SCALES_MM if scale_mm * per_mm <= _SCALE_PART * most), 0.5
    )
    left, middle = right - round(length_mm * per_mm), top + _LABEL // 2 - 2
    draw.rectangle((left, middle - 2, right - 1, middle + 1), fill=ink)
    draw.text((left - 8, middle), f"{length_mm:g} mm", fill=ink, font=font, anchor="rm")


def _draw_classes(
    draw: ImageDraw.ImageDraw,
    font: ImageFont.ImageFont | ImageFont.FreeTypeFont,
    end: tuple[int, int],
) -> None:
    """Write the afferent classes in their colors. ``end`` is the top right corner of the text."""
    right, top = end
    for afferent, color in reversed(CLASS_COLORS.items()):
        draw.text((right, top), afferent.name, fill=color, font=font, anchor="ra")
        right -= round(draw.textlength(afferent.name, font=font)) + _LABEL // 2


class PageDrawing(DeliveredDrawing):
    """Picture of all pages or lines that the finger touched, with the mean response at each point.

    ``sheet`` returns the current page or line, or None if the source has none.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        afferents: tuple[Afferent, ...],
        sheet: Callable[[], Sheet | None] = lambda: None,
    ) -> None:
        super().__init__(profile, bank, afferents, profile.optics.magnification)
        self._sheet, self._sheets = sheet, dict[int, Sheet]()

    def watch(self, sent: StepResult) -> None:
        """Record the page or line under the finger and, if sent with current, the step."""
        super().watch(sent)
        if (sheet := self._sheet()) is not None:
            self._sheets[sheet.number] = sheet

    def under(self) -> Under:
        """Describe the area of all touched pages. Without pages, describe the touched area."""
        if not (self._sheets or self.poses):
            raise SmartTouchError("nothing to draw, as no pulse was delivered: raise the intensity")
        places_mm = [self.places_mm(pose) for pose in self.poses.values()]
        margin_mm = np.array(self._cell_mm)
        if self._sheets:
            corners = [np.array(sheet.corner_mm) for sheet in self._sheets.values()]
            ends = [
                sheet.page.size_mm + np.array(sheet.corner_mm) for sheet in self._sheets.values()
            ]
            places_mm, margin_mm = [np.array([*corners, *ends])], np.zeros(2)
        every = np.concatenate(places_mm)
        left_mm, top_mm = (every.min(axis=0) - margin_mm).tolist()
        wide_mm, high_mm = (np.ptp(every, axis=0) + 2 * margin_mm).tolist()

        def draw(shape: tuple[int, int], pixel_mm: float) -> Grey:
            drawn = np.full(shape, 255, np.uint8)
            for sheet in self._sheets.values():
                (x_mm, y_mm), page = sheet.corner_mm, sheet.page
                top, left = round((y_mm - top_mm) / pixel_mm), round((x_mm - left_mm) / pixel_mm)
                space = drawn[top:, left:]
                wide, high = (max(1, round(side_mm / pixel_mm)) for side_mm in page.size_mm)
                size = min(wide, space.shape[1]), min(high, space.shape[0])
                space[: size[1], : size[0]] = cv2.resize(
                    page.grey, size, None, 0, 0, cv2.INTER_AREA
                )
            return drawn

        title = "What lay under the finger"
        return title, (left_mm, top_mm), (wide_mm, high_mm), draw if self._sheets else None


class DeliveredPicture(Listener):
    """Listener that draws the page, the delivered pulses and the spikes of a simulated finger.

    The board must report every pulse, as ``simulated:`` does. If no finger can be simulated for the
    profile, the picture omits the spikes, and a note gives the reason.
    """

    def __init__(self, path: Path, finger: int = 1, anatomy: str | Path = "branched") -> None:
        super().__init__()
        self.path = path
        self._seed, self._anatomy = finger, anatomy
        self._drawing: DeliveredDrawing | None = None
        self._driver: SimulatedDriver | None = None

    def prepare(self, run: RunContext) -> None:
        """Check the file name and the board. A source without a drawing gets a `PageDrawing`."""
        if self.path.suffix.lower() not in ("", ".png"):
            raise SmartTouchError(f"cannot draw {self.path}: its name must end in .png")
        load_anatomy(self._anatomy)
        if not isinstance(run.board.driver, SimulatedDriver):
            raise SmartTouchError(
                "the picture needs a report of every pulse, which this board does not send: "
                "add --board simulated:"
            )
        self._driver = run.board.driver
        source_drawing = getattr(run.source, "drawing", None)
        if source_drawing is not None:
            self._drawing = source_drawing(run.profile, run.bank)
        else:
            afferents = run.controls.state(0).mode.afferents
            self._drawing = PageDrawing(run.profile, run.bank, afferents, lambda: run.source.sheet)

    def step(self, result: StepResult) -> None:
        """Let the drawing record the step."""
        if self._drawing is not None:
            self._drawing.watch(result)

    def finish(self, run: RunContext) -> None:
        """Write the picture."""
        assert self._drawing is not None
        assert self._driver is not None
        self._drawing.deliver(*self._driver.take_pulses(), self._finger(run.profile))
        self._drawing.save(self.path)

    def _finger(self, profile: Profile) -> Finger | None:
        try:
            finger = Finger(profile, self._seed, self._anatomy)
            _ = finger.rows
        except DesignError as error:
            self.notes.append(f"the picture omits spikes, as no finger can be simulated: {error}")
            return None
        return finger
