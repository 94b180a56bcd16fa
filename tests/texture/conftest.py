"""The 8 x 8 array on a mouse."""

import pytest

from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.window import profile_for_reading


@pytest.fixture(scope="session")
def mouse():
    """The electric mouse, millimeter by millimeter."""
    return profile_for_reading(load_profile("electric-mouse"))


@pytest.fixture(scope="session")
def mouse_bank(mouse):
    return load_bank(mouse)
