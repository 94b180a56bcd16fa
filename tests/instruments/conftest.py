"""Profile of the electric mouse (8 x 8 electrodes), and textures as image files."""

import math

import cv2
import numpy as np
import pytest
from PIL import Image

from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.profile import load_profile


@pytest.fixture(scope="session")
def mouse():
    """Return the profile electric-mouse; its frames show the area of the array at scale 1."""
    return profile_for_reading(load_profile("electric-mouse"))


DPI = 254
"""Resolution of the image files, dots per inch: 0.1 mm per pixel."""


def grating_file(path, angle_deg, kind="square", noise=0.0):
    """Write a 90 x 40 mm image of a grating of 4 mm pitch; its ridges are square, thin or faint."""
    y, x = np.mgrid[:400, :900] / 10
    angle = math.radians(angle_deg)
    phase = (x * math.cos(angle) + y * math.sin(angle)) / 4
    ridge = {
        "square": (phase + 0.25) % 1 < 0.5,
        "thin": (phase + 0.1) % 1 < 0.2,
        "faint": 0.5 + 0.1 * np.cos(2 * math.pi * phase),
    }[kind]
    grey = 255 * (1 - ridge) + noise * np.random.default_rng(1).standard_normal(ridge.shape)
    Image.fromarray(np.clip(grey, 0, 255).astype(np.uint8)).save(path, dpi=(DPI, DPI))
    return path


def object_file(path, kind):
    """Write an image of 80 x 40 mm with a disc of 10 mm or a cross of 14 mm in its middle."""
    image = np.full((400, 800), 255, np.uint8)
    if kind == "disc":
        cv2.circle(image, (400, 200), 50, 0, -1)
    else:
        image[185:215, 330:470] = image[130:270, 385:415] = 0
    Image.fromarray(image).save(path, dpi=(DPI, DPI))
    return path
