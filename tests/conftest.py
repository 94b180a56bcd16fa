"""What many tests start from."""

import numpy as np
import pytest

from smarttouch.profile import DEFAULT_PROFILE, load_profile
from smarttouch.sensing.frame import Frame, Pose


@pytest.fixture(scope="session")
def profile():
    return load_profile(DEFAULT_PROFILE)


@pytest.fixture(scope="session")
def bank(profile):
    from smarttouch.modes.bank import load_bank

    return load_bank(profile)


@pytest.fixture
def make_frame():
    """Return a maker of frames: an image, a time and a force."""

    def make(image, time_ns=0, force_n=1.0):
        return Frame(np.asarray(image, np.uint8), time_ns, Pose(0.0, 0.0), force_n)

    return make


@pytest.fixture(scope="session")
def patch():
    """Return a maker of 64 x 64 patches: white paper with one black bar of columns."""

    def make(first=24, last=40, paper=220, ink=30):
        image = np.full((64, 64), paper, np.uint8)
        image[:, first:last] = ink
        return image

    return make
