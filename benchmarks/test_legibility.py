"""Character error rates of text that Tesseract recognizes in delivered pulses and on pages.

Printed pages have 10, 12 or 14 points, and are clean, rotated, unevenly lit or noisy. One more page
is the sample page of scikit-image. Arrays have 8, 12, 16 and 24 rows. Activation is plain, graded,
or graded with shared slots. ``smarttouch simulate page`` measures error rates of your own page.
"""

import numpy as np
import pytest
from PIL import Image
from skimage import data

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.reading.legibility import LineDelivery, legibility_of_shapes
from smarttouch.reading.letter_shapes import Shapes
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.stimulation.scan_sequence import SlotPolicy
from tests.pages.printed import degrade, print_page

TEXT = [
    "The quick brown fox jumps over the lazy dog.", "A finger moves over print, and what is seen",
    "becomes a pattern of 64 small currents; each", "is felt as pressure, or as a faint vibration.",
    "In 1998 the first displays had 120 points.", "Nobody (not even I) could read them then.",
]  # fmt: skip
SKIMAGE = """Region-based segmentation
Let us first determine markers of the coins and the
background. These markers are pixels that we can label
unambiguously as either object or background. Here,
the markers are found at the two extreme parts of the
histogram of grey values:
>>> markers = np.zeros_like(coins)"""
ROWS = [8, 12, 16, 24]
PAGES = {
    "10 pt": (10, {}), "12 pt": (12, {}), "14 pt": (14, {}), "12 pt, sans": (12, {}),
    "12 pt, turned by 3°": (12, {"skew_deg": 3}), "12 pt, uneven light": (12, {"uneven": 0.6}),
    "12 pt, noise": (12, {"noise": 20}), "scikit-image": (0, {}),
}  # fmt: skip


def page_file(folder, name, text):
    """Write the image of a page to a file; return its path and the true text."""
    size_pt, damage = PAGES[name]
    path = folder / "page.png"
    if name == "scikit-image":
        # Below these lines, half of another line is visible. Text recognized in it is an error.
        Image.fromarray(data.page()).save(path)
        return path, SKIMAGE
    font = "DejaVuSans" if "sans" in name else "DejaVuSerif"
    printed = print_page(text, size_pt=size_pt, font=font)
    Image.fromarray(np.asarray(degrade(printed, **damage).page.grey)).save(path)
    return path, "\n".join(text)


def array_of(rows):
    """Return a profile with ``rows`` rows. 4 columns are enough, because text moves past them."""
    table = load_profile("electric-mouse").model_dump()
    table["array"] |= {"rows": rows, "columns": 8 if rows == 8 else 4}
    return profile_for_reading(Profile.model_validate(table))


@pytest.mark.parametrize("rows", ROWS)
def test_legibility(rows, tmp_path, row, quick):
    if quick and rows != ROWS[0]:
        pytest.skip("--quick runs only one size, because all sizes run the same code")
    profile = array_of(rows)
    bank = load_bank(profile)

    ways = [(False, ()), (True, ()), (True, (Afferent.RA,))]
    text = TEXT[:1] if quick else TEXT
    for name in ["12 pt, noise"] if quick else PAGES:
        path, truth = page_file(tmp_path, name, text)
        cells = {}
        for graded, shared in ways:
            shapes = Shapes(graded)
            motion = shapes.motion(profile)
            reading = LineDelivery(profile, bank, shapes.tone, motion, Mode.RA, SlotPolicy(shared))
            found = legibility_of_shapes(ReadingMaterial(str(path)), reading, truth)
            name_of_way = f"{'graded' if graded else 'plain'}{', shared slots' * bool(shared)}"
            cells[name_of_way] = f"{found.character_error_rate:.3f}"
        known = {"rows": rows, "page": name, "on the page": f"{found.page_error_rate:.3f}"}
        row("Character error rates, on the page and from pulses", known | cells)
