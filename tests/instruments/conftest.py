"""The 8 x 8 array on a mouse."""

import pytest

from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile


@pytest.fixture(scope="session")
def mouse():
    """The electric mouse, millimeter by millimeter."""
    return profile_for_reading(load_profile("electric-mouse"))


@pytest.fixture(scope="session")
def mouse_bank(mouse):
    return load_bank(mouse)


@pytest.fixture(scope="session")
def brief(mouse, changed):
    """The same with pulses so short that neither net current nor its balance slows a frame."""
    return changed(mouse, {"pulse.width_us": 20})
