"""Letter shapes on an array: lines of print, and single letters."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.morphology import skeletonize

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError, ReadingError, SmartTouchError
from smarttouch.imaging.reading_profile import (
    FEWEST_ROWS,
    pixel_pitch_mm,
    profile_for_reading,
    rows_of,
    usual_speed_mm_s,
)
from smarttouch.imaging.sensor_registration import PIXELS_PER_CELL
from smarttouch.imaging.tactile_mapper import TactileMapper, Tone
from smarttouch.pages.prepared_page import PreparedPage
from smarttouch.profile import Profile
from smarttouch.reading.line_source import LineMotion, TouchLine
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.reading.recognition import Note, recognized_lines
from smarttouch.sources.source_contract import Frame

ENOUGH_ROWS = 8
"""Smallest number of rows of electrodes that is sufficient for letters. With 4 rows, half of the
characters are unreadable."""
INK_LEVEL = 128  # a pixel of a prepared page is ink if its gray level is below this
NIB_PIXELS = PIXELS_PER_CELL - 1  # width of a thinned stroke
_PLAIN = Tone(0.3, 0.3, prepared=True)
"""Tone curve of lines. An electrode is active if at least 30 % of its cell is ink. With 50 %, thin
strokes would be lost."""
_GRADED = Tone(0.0, 1.0, prepared=True)
_DRAWN = Tone(0.35, 0.35, prepared=True)
"""Tone curve of single letters, whose strokes are one cell wide."""
UNKNOWN_LEVEL = 0.7
"""Intensity for simulated fingers, relative to the comfort level. Of all intensities that were
tested with two simulated anatomies, it gives the fewest errors in the anatomy with more errors
(`examples/studies/reading_pages.py`)."""


@dataclass(frozen=True)
class Shapes:
    """Presentation of text as letter shapes, in lines of print."""

    graded: bool = False
    """Whether activation rises with the ink in a cell (for simulations); otherwise it is 0 or 1."""

    @property
    def tone(self) -> Tone:
        """Tone curve from ink to activation."""
        return _GRADED if self.graded else _PLAIN

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return a smooth motion, so that each edge of a letter passes over each electrode."""
        return LineMotion(usual_speed_mm_s(profile, rate_hz) if speed_mm_s is None else speed_mm_s)

    def lines(self, source: ReadingMaterial, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of letter shapes with their text, recognized by Tesseract if unknown."""
        require_rows(profile, source.note)
        if source.holds_cells:
            raise ReadingError(f"{source.name} contains Braille, not letters: add --as braille")
        for prepared in source.prepared():
            words = _words_of(prepared, source)
            for index in range(len(prepared.lines)):
                yield shape_line(prepared, index, profile, next(words, ""))


def _words_of(prepared: PreparedPage, source: ReadingMaterial) -> Iterator[str]:
    """Yield the text of each line; empty without Tesseract."""
    try:
        for _, words in recognized_lines(prepared, source.options, source.note):
            yield words
    except ReadingError as error:
        source.note(str(error))


def require_rows(profile: Profile, note: Note) -> None:
    """Raise ReadingError if the array has too few rows for letters. Add a note if many letters
    would look alike."""
    rows = _require_fewest_rows(profile, ReadingError)
    if rows < ENOUGH_ROWS:
        note(
            f"{profile.name} has {rows} rows of electrodes, but many letters are indistinguishable "
            f"on fewer than {ENOUGH_ROWS}: read Braille instead (--as braille)"
        )


def _require_fewest_rows(profile: Profile, error: type[SmartTouchError]) -> int:
    rows = rows_of(profile)
    if rows < FEWEST_ROWS:
        raise error(
            f"{profile.name} has {rows} row{'s' * (rows > 1)} of electrodes, but letters need at "
            f"least {FEWEST_ROWS}: choose another profile, for example electric-mouse"
        )
    return rows


def shape_line(prepared: PreparedPage, index: int, profile: Profile, text: str = "") -> TouchLine:
    """Return a line of print. Its height, from ascender to descender, fills the array."""
    strip = prepared.strip(index, profile.optics.sensor_rows)
    pixel_mm = pixel_pitch_mm(profile)
    half_mm = profile.optics.field_width_mm / 2
    return TouchLine(strip, -half_mm, strip.shape[1] * pixel_mm + half_mm, text)


def thin(strip: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a strip in which strokes are thinned to the width of one cell."""
    middle = skeletonize(strip < INK_LEVEL).astype(np.uint8)
    nib = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (NIB_PIXELS, NIB_PIXELS))
    return np.asarray(255 * (1 - cv2.dilate(middle, nib)), np.uint8)


ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_DRAWN_PX = 400


def draw_letter(letter: str, profile: Profile) -> NDArray[np.float32]:
    """Return the activation for a letter that fills the array, (E,) float32, 0 or 1. The letter is
    centered, keeps its proportions, and has strokes one electrode wide."""
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
