"""Lines of print as letter shapes: plain, thinned or graded."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.morphology import skeletonize

from smarttouch.documents.prepare import PreparedPage
from smarttouch.documents.strips import SIDES
from smarttouch.errors import ReadingError
from smarttouch.imaging.mapping import Tone
from smarttouch.imaging.registration import PIXELS_PER_CELL
from smarttouch.profile import Profile
from smarttouch.reading.cursor import LineMotion
from smarttouch.reading.printed import Note
from smarttouch.reading.source import Source
from smarttouch.reading.touch_line import Place, TouchLine
from smarttouch.reading.window import FEWEST_ROWS, pixel_of, rows_of, usual_speed

ENOUGH_ROWS = 8
"""Sufficient rows: on 4 half of the characters are lost, on 8 hardly one in a hundred."""
INK_LEVEL = 128
"""Level of prepared paper below which is ink."""
NIB_PIXELS = PIXELS_PER_CELL - 1
"""Width of a thinned stroke."""
_PLAIN, _THINNED = 0.3, 0.35
"""Least ink of an active cell. Half of it, the obvious choice, loses thin strokes: of print in
8 rows 8 to 20 % of the characters then cannot be read, here 1 to 3 %."""


class Style(StrEnum):
    """Styles of letter shapes: mappings from ink to activation."""

    PLAIN = "plain"
    """On or off."""
    THINNED = "thinned"
    """On or off, every stroke as wide as a cell: thin ones stay whole, and holes of thick ones
    open."""
    GRADED = "graded"
    """Activation in proportion to the ink in a cell."""


_TONES = {
    Style.PLAIN: Tone(_PLAIN, _PLAIN, prepared=True),
    Style.THINNED: Tone(_THINNED, _THINNED, prepared=True),
    Style.GRADED: Tone(0.0, 1.0, prepared=True),
}


@dataclass(frozen=True)
class Shapes:
    """Letter-shape presentation: lines of print under the finger."""

    style: Style = Style.GRADED

    @property
    def tone(self) -> Tone:
        """Tone curve from ink to activation."""
        return _TONES[self.style]

    def motion(
        self, profile: Profile, speed_mm_s: float | None = None, rate_hz: float | None = None
    ) -> LineMotion:
        """Return the motion of lines: smooth, so that every edge passes every electrode."""
        return LineMotion(usual_speed(profile, rate_hz) if speed_mm_s is None else speed_mm_s)

    def lines(self, source: Source, profile: Profile) -> Iterator[TouchLine]:
        """Yield lines of letter shapes."""
        require_rows(profile, source.note)
        if source.holds_cells:
            raise ReadingError(
                f"{source.name} holds Braille, not letters: read it as Braille", about="kind"
            )
        for prepared in source.prepared():
            for index in range(len(prepared.lines)):
                yield shape_line(prepared, index, profile, self.style)


def require_rows(profile: Profile, note: Note) -> None:
    """Raise unless an array has enough rows for letters; add a note if they are few."""
    rows = rows_of(profile)
    if rows < FEWEST_ROWS:
        raise ReadingError(
            f"{profile.name} has {rows} row{'s' * (rows > 1)} of electrodes, letter shapes need at "
            f"least {FEWEST_ROWS}: choose another profile, for example electric-mouse",
            about="profile",
        )
    if rows < ENOUGH_ROWS:
        note(
            f"{profile.name} has {rows} rows of electrodes: many letters are indistinguishable on "
            f"fewer than {ENOUGH_ROWS}, read Braille instead"
        )


def shape_line(prepared: PreparedPage, index: int, profile: Profile, style: Style) -> TouchLine:
    """Return a line of print, magnified so that ascender to descender fills the array."""
    line = prepared.lines[index]
    rows = profile.optics.sensor_rows
    strip = prepared.strip(index, rows)
    if style is Style.THINNED:
        strip = thin(strip)
    pixel_mm = pixel_of(profile)
    half_mm = profile.optics.field_width_mm / 2
    # A strip begins and ends with some paper.
    margin_mm = SIDES * line.height_mm
    place = Place(
        line.left_mm - margin_mm,
        line.right_mm + margin_mm,
        (line.top_mm + line.bottom_mm) / 2,
        rows * pixel_mm / line.height_mm,
    )
    return TouchLine(strip, -half_mm, strip.shape[1] * pixel_mm + half_mm, place=place)


def thin(strip: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a strip with one cell's width along the middle of each stroke."""
    middle = skeletonize(strip < INK_LEVEL).astype(np.uint8)
    nib = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (NIB_PIXELS, NIB_PIXELS))
    return np.asarray(255 * (1 - cv2.dilate(middle, nib)), np.uint8)
