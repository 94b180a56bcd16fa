"""Profiles whose electrodes come from a file or an array, and parsing of electrode lists."""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import ProfileError
from smarttouch.profile.profile import require_driven

from ..support.checks import raises

MOUSE = st.load_profile("electric-mouse")
PLACES = np.array([[0, 0], [2, 0.1], [4, 0], [0.1, 2], [2, 2.1], [4, 1.9]])


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "mine.csv"
    rows = [f"{x},{y},{1 + 0.1 * number}" for number, (x, y) in enumerate(PLACES.tolist())]
    path.write_text("\n".join(["x_mm,y_mm,diameter_mm", *rows]), encoding="utf-8")
    return path


def test_places_and_sizes_are_those_of_the_table(table):
    """Electrodes keep the order of the table; positions are relative to the middle of the array."""
    electrodes = MOUSE.with_electrodes(table).electrodes
    np.testing.assert_allclose(electrodes.position_mm, PLACES - [2, 1.05])
    assert [size for _, (size, _) in electrodes.own] == [1 + 0.1 * each for each in range(6)]
    discs = MOUSE.with_electrodes(PLACES, "mine")
    assert discs.title == "mine"
    assert (discs.electrodes.shape, discs.electrodes.size_mm) == ("disc", (1.0, 0.0))


def test_values_of_each_electrode_become_the_least_of_all():
    perception = MOUSE.perception.model_dump() | {
        "threshold_ma": tuple(np.linspace(1, 1.5, 64).tolist()),
        "comfort_ma": tuple(np.linspace(1.8, 2.4, 64).tolist()),
    }
    limits = MOUSE.limits.model_dump() | {"electrode_ma": tuple(np.linspace(2.5, 5, 64).tolist())}
    output = MOUSE.output.model_dump() | {"masked": (3, 4)}
    own = MOUSE.model_copy(update={"perception": perception, "limits": limits, "output": output})
    made = own.with_electrodes(PLACES)
    assert made.threshold_ma.tolist() == [1.0] * 6
    np.testing.assert_allclose(made.full_ma, 1.8)
    assert made.limits.electrode_ma == (2.5,) * 6
    assert made.output.masked == ()
    assert made.pulse == MOUSE.pulse


@pytest.mark.parametrize(("places", "words"), [
    ([(0, 0), (0, 0)], "coincide"), ([(0, 0)], "1 electrode"), ([], "(0,)"), ([1, 2], "(2,)"),
    ([(0, 0), (np.nan, 1)], "nan"), ([(0, 0, 1), (2, 0, -1)], "-1"),
    (np.zeros((5000, 2)), "4096"),
])  # fmt: skip
def test_what_is_no_array_is_one_sentence(places, words):
    with raises(ProfileError, value=words):
        MOUSE.with_electrodes(places)


@pytest.mark.parametrize(("places", "first", "shown"), [
    ([(0, 0), (3, 0), (3.4, 0.7)], 1, ["1 and 2", "0.806 mm"]),
    ([(0, 0, 1), (1.4, 0, 2), (4, 0, 1)], 0, ["0 and 1", "1.4 mm"]),
])  # fmt: skip
def test_electrodes_that_overlap_are_refused(places, first, shown):
    with raises(ProfileError, key="electrodes", electrode=first, value=shown):
        MOUSE.with_electrodes(places)


@pytest.mark.parametrize(("sites", "expected"), [
    ("0-3,12", [0, 1, 2, 3, 12]), (" 5 , 5-6", [5, 6]), ("63", [63]), ([8, 3, 8], [3, 8]),
])  # fmt: skip
def test_by_number_and_range(sites, expected):
    assert require_driven(MOUSE, sites, ProfileError, "site").tolist() == expected


@pytest.mark.parametrize(("sites", "value", "more"), [
    *((text, text, {}) for text in ("", "a", "3-", "-3", "1;2", "5-2", "64", "0-64")),
    *((sites, site, {"electrode": site}) for sites, site in (([], None), ([64], 64), ([-1], -1))),
])  # fmt: skip
def test_what_is_no_list_of_electrodes(sites, value, more):
    with raises(ProfileError, names="sites", value=value, **more):
        require_driven(MOUSE, sites, ProfileError, "sites")


def test_masked_ones(changed):
    broken = changed(MOUSE, {"output.masked": (1, 27)})
    for sites in ([27, 28], "20-30"):
        with raises(ProfileError, names="site", value=27, allowed=(0, 63), electrode=27):
            require_driven(broken, sites, ProfileError, "site")
