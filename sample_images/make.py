"""Makes the sample pages anew: ``python sample_images/make.py``."""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from smarttouch.pages.prepared_page import PRINT_DPI, print_text

HERE = Path(__file__).parent
TEXT = (
    "A page is a quiet place.\n"
    "Rest one finger on a line\n"
    "and let the letters pass\n"
    "beneath it, stroke by stroke."
)


def photographed(grey, seed=1):
    """A soft, noisy, unevenly lit picture of a slightly turned page."""
    rng = np.random.default_rng(seed)
    height, width = grey.shape
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), 0.5, 1.0)
    page = cv2.warpAffine(grey, turn, (width, height), borderValue=255).astype(np.float32)
    fibers = cv2.GaussianBlur(rng.normal(0, 1, (height, width)).astype(np.float32), (0, 0), 3)
    page = 28 + page * 0.76 + fibers / fibers.std() * 2.5
    page = cv2.GaussianBlur(page, (0, 0), 1.6)
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    light = 1.0 - 0.12 * (x - 0.4) ** 2 - 0.08 * (y + 0.5) ** 2 + 0.05 * x
    return np.clip(page * light + rng.normal(0, 3, page.shape), 0, 255).astype(np.uint8)


def save(name, grey, dpi=PRINT_DPI):
    Image.fromarray(grey).save(HERE / name, dpi=(dpi, dpi), optimize=True)


page = print_text(TEXT).grey
save("page.png", page)
photo = photographed(page)
save("photo.png", cv2.resize(photo, None, fx=2 / 3, fy=2 / 3, interpolation=cv2.INTER_AREA), 200)
save("light_on_dark.png", 255 - page)
