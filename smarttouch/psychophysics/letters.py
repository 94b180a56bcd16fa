"""Letters drawn with the electrodes of an array."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from smarttouch.errors import ExperimentError
from smarttouch.imaging.registration import Registration
from smarttouch.profile import Profile
from smarttouch.reading.shapes import Shapes, Style, thin
from smarttouch.reading.window import FEWEST_ROWS, profile_for_reading, rows_of

ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_DRAWN_PX = 400


def parse_letters(text: str | None) -> str:
    """Return the letters that ``ABC`` names, each once, two or more of A to Z; the alphabet if
    None."""
    letters = ALPHABET if text is None else "".join(dict.fromkeys(text.upper().replace(",", "")))
    strange = [each for each in letters if each not in ALPHABET]
    if strange or len(letters) < 2:
        raise ExperimentError(
            f"letters {text!r} must be two or more letters from A to Z, as in AEIOU",
            about="letters",
        )
    return letters


def draw_letter(letter: str, profile: Profile) -> NDArray[np.float32]:
    """Return the activation, (E,) float32, 0 or 1, that draws a letter as large as the array.

    Drawn in the middle of an array with rows and columns, in its own proportions, with strokes one
    electrode wide.
    """
    rows = rows_of(profile)
    if rows < FEWEST_ROWS:
        raise ExperimentError(
            f"{profile.name} has {rows} row{'s' * (rows > 1)} of electrodes, letters need at least "
            f"{FEWEST_ROWS}: choose another profile, for example electric-mouse",
            about="profile",
        )
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
    ink = 255 - thin(image)
    activation = Registration(profile.electrodes, window.optics, shape).sample(ink)
    Shapes(Style.THINNED).tone.apply(activation)
    activation[list(profile.output.masked)] = 0
    return activation
