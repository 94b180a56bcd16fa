"""Letter shapes: single letters on an array, and lines of print."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.morphology import skeletonize

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError, ReadingError, SmartTouchError
from smarttouch.imaging.array_window import (
    FEWEST_ROWS,
    pixel_pitch_mm,
    profile_for_reading,
    rows_of,
    usual_speed_mm_s,
)
from smarttouch.imaging.registration import PIXELS_PER_CELL
from smarttouch.imaging.tactile_mapper import TactileMapper, Tone
from smarttouch.pages.prepared_page import PreparedPage
from smarttouch.profile import Profile
from smarttouch.reading.line_source import LineMotion, TouchLine
from smarttouch.reading.material import ReadingMaterial
from smarttouch.reading.recognition import Note, recognized_lines
from smarttouch.sources.source_contract import Frame

ENOUGH_ROWS = 8
"""Sufficient rows: on 4 half of the characters are lost, on 8 hardly one in a hundred."""
INK_LEVEL = 128  # level of prepared paper below which is ink
NIB_PIXELS = PIXELS_PER_CELL - 1  # width of a thinned stroke
_PLAIN = Tone(0.3, 0.3, prepared=True)
"""Least ink of an active cell. Half of it, the obvious choice, loses thin strokes: of print in
8 rows 8 to 20 % of the characters then cannot be read, here 1 to 3 %."""
_GRADED = Tone(0.0, 1.0, prepared=True)
_DRAWN = Tone(0.35, 0.35, prepared=True)
"""Tone of single letters, whose strokes are one cell wide."""
UNKNOWN_LEVEL = 0.7
"""Part of comfort at which lines are read best, at the worse of two anatomies, by simulated fingers
whose level is not known: `examples/studies/reading_pages.py`."""


@dataclass(frozen=True)
class Shapes:
    """Letter-shape presentation: lines of print under the finger."""

    graded: bool = False
    """Whether activation is in proportion to the ink in a cell, as simulations need it."""

    @property
    def tone(self) -> Tone:
        """Tone curve from ink to activation."""
        return _GRADED if self.graded else _PLAIN

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return the motion of lines: smooth, so that every edge passes every electrode."""
        return LineMotion(usual_speed_mm_s(profile, rate_hz) if speed_mm_s is None else speed_mm_s)

    def lines(self, source: ReadingMaterial, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of letter shapes and their words, by Tesseract where these are not known."""
        require_rows(profile, source.note)
        if source.holds_cells:
            raise ReadingError(f"{source.name} holds Braille, not letters: read it as Braille")
        for prepared in source.prepared():
            words = _words_of(prepared, source)
            for index in range(len(prepared.lines)):
                yield shape_line(prepared, index, profile, next(words, ""))


def _words_of(prepared: PreparedPage, source: ReadingMaterial) -> Iterator[str]:
    """Yield the words of each line; none without Tesseract."""
    try:
        for _, words in recognized_lines(prepared, source.options, source.note):
            yield words
    except ReadingError as error:
        source.note(str(error))


def require_rows(profile: Profile, note: Note) -> None:
    """Raise unless an array has enough rows for letters; add a note if they are few."""
    rows = _require_fewest_rows(profile, ReadingError)
    if rows < ENOUGH_ROWS:
        note(
            f"{profile.name} has {rows} rows of electrodes: many letters are indistinguishable on "
            f"fewer than {ENOUGH_ROWS}, read Braille instead"
        )


def _require_fewest_rows(profile: Profile, error: type[SmartTouchError]) -> int:
    rows = rows_of(profile)
    if rows < FEWEST_ROWS:
        raise error(
            f"{profile.name} has {rows} row{'s' * (rows > 1)} of electrodes, letters need at least "
            f"{FEWEST_ROWS}: choose another profile, for example electric-mouse"
        )
    return rows


def shape_line(prepared: PreparedPage, index: int, profile: Profile, text: str = "") -> TouchLine:
    """Return a line of print, magnified so that ascender to descender fills the array."""
    strip = prepared.strip(index, profile.optics.sensor_rows)
    pixel_mm = pixel_pitch_mm(profile)
    half_mm = profile.optics.field_width_mm / 2
    return TouchLine(strip, -half_mm, strip.shape[1] * pixel_mm + half_mm, text)


def thin(strip: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a strip with one cell's width along the middle of each stroke."""
    middle = skeletonize(strip < INK_LEVEL).astype(np.uint8)
    nib = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (NIB_PIXELS, NIB_PIXELS))
    return np.asarray(255 * (1 - cv2.dilate(middle, nib)), np.uint8)


ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_DRAWN_PX = 400


def draw_letter(letter: str, profile: Profile) -> NDArray[np.float32]:
    """Return the activation, (E,) float32, 0 or 1, that draws a letter as large as the array.

    Drawn in the middle of an array with rows and columns, in its own proportions, with strokes one
    electrode wide.
    """
    _require_fewest_rows(profile, ExperimentError)
    window = profile_for_reading(profile)
    shape = (window.optics.sensor_rows, window.optics.sensor_columns)
    sheet = Image.new("L", (2 * _DRAWN_PX, 2 * _DRAWN_PX), 255)
    font = ImageFont.load_default(size=_DRAWN_PX)
    ImageDraw.Draw(sheet).text((_DRAWN_PX // 2, _DRAWN_PX // 4), letter, fill=0, font=font)
    cut = sheet.crop(Image.eval(sheet, lambda grey: 255 - grey).getbbox())
    scale = min(shape[0] / cut.height, shape[1] / cut.width)
    size = (max(1, round(cut.width * scale)), max(1, round(cut.height * scale)))
    image = np.full(shape, 255, np.uint8)
    top, left = (shape[0] - size[1]) // 2, (shape[1] - size[0]) // 2
    fitted = cut.resize(size, Image.Resampling.BOX)
    image[top : top + size[1], left : left + size[0]] = np.asarray(fitted)
    frame = Frame(thin(image), 0, force_n=profile.force.full_n)
    drawn = TactileMapper(window, tone=_DRAWN).map(frame, Mode.RA).activation[Afferent.RA]
    drawn[list(profile.output.masked)] = 0
    return np.asarray(drawn, np.float32)
