"""Fixtures: a profile for reading, its kernel bank, and lines to read."""

import numpy as np
import pytest

from smarttouch.imaging.reading_profile import pixel_pitch_mm, profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.line_source import TouchLine


@pytest.fixture(scope="session")
def reading():
    """Return the profile of the 8 x 8 array for reading rendered text."""
    return profile_for_reading(load_profile("electric-mouse"))


@pytest.fixture(scope="session")
def reading_bank(reading):
    return load_bank(reading)


@pytest.fixture
def make_line(reading):
    """Return a function that makes a line with a bar of ink between two positions, in mm."""

    def make(length_mm=30.0, bar_mm=(10.0, 14.0), **more):
        pixel_mm = pixel_pitch_mm(reading)
        image = np.full((reading.optics.sensor_rows, round(length_mm / pixel_mm)), 255, np.uint8)
        image[:, round(bar_mm[0] / pixel_mm) : round(bar_mm[1] / pixel_mm)] = 0
        half_mm = reading.optics.field_width_mm / 2
        return TouchLine(image, -half_mm, length_mm + half_mm, **more)

    return make
