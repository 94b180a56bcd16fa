"""The 8 x 8 array on a mouse."""

import pytest

from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.window import profile_for_reading


@pytest.fixture(scope="session")
def mouse(changed):
    """The electric mouse, millimeter by millimeter.

    Its pulses are so short that net current leaves all points at once 50 of them a second.
    """
    return changed(profile_for_reading(load_profile("electric-mouse")), {"pulse.width_us": 20})


@pytest.fixture(scope="session")
def mouse_bank(mouse):
    return load_bank(mouse)
