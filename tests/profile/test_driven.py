"""Electrodes by numbers and ranges, and which cannot be driven."""

import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.profile import load_profile
from smarttouch.profile.profile import require_driven

from ..raising import raises

MOUSE = load_profile("electric-mouse")


@pytest.mark.parametrize(("sites", "expected"), [
    ("0-3,12", [0, 1, 2, 3, 12]), (" 5 , 5-6", [5, 6]), ("63", [63]), ([8, 3, 8], [3, 8]),
])  # fmt: skip
def test_by_number_and_range(sites, expected):
    assert require_driven(MOUSE, sites, ProfileError, "site").tolist() == expected


@pytest.mark.parametrize("text", ["", "a", "3-", "-3", "1;2", "5-2", "64", "0-64"])
def test_what_is_no_list_of_electrodes(text):
    with raises(ProfileError, key="sites", value=text):
        require_driven(MOUSE, text, ProfileError, "sites")


@pytest.mark.parametrize(("sites", "site"), [([], None), ([64], 64), ([-1], -1)])
def test_what_is_not_there(sites, site):
    with raises(ProfileError, key="site", value=site, electrode=site):
        require_driven(MOUSE, sites, ProfileError, "site")


def test_masked_ones(changed):
    broken = changed(MOUSE, {"output.masked": (1, 27)})
    for sites in ([27, 28], "20-30"):
        with raises(ProfileError, key="site", value=27, allowed=(0, 63), electrode=27):
            require_driven(broken, sites, ProfileError, "site")
