"""Letters are drawn with electrodes, each so that it differs from all others."""

import numpy as np
import pytest

from smarttouch.base.errors import ExperimentError
from smarttouch.profile import load_profile
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter, parse_letters

from ..support.checks import raises


def drawing(letter, profile):
    return ["".join("#" if each else "." for each in row) for row in letter.reshape(8, 8)]


def test_an_l_is_an_l(profile):
    rows = drawing(draw_letter("L", profile), profile)
    upright = rows[0].index("#")
    assert all(row[upright] == "#" for row in rows)
    assert rows[-1].count("#") >= 4
    assert all(row.count("#") == 1 for row in rows[:-2])


def test_all_letters_differ(profile):
    drawn = np.array([draw_letter(each, profile) for each in ALPHABET])
    apart = (drawn[:, None] != drawn[None]).sum(axis=2)
    assert apart[~np.eye(26, dtype=bool)].min() >= 4
    assert set(np.unique(drawn)) == {0.0, 1.0}
    # As high as the array, but for W, which is as wide.
    rows = drawn.reshape(26, 8, 8).any(axis=2).sum(axis=1)
    assert rows.min() >= 6
    assert (rows == 8).sum() == 25


def test_masked_electrodes_draw_nothing(profile, changed):
    site = int(np.flatnonzero(draw_letter("E", profile))[0])
    assert draw_letter("E", changed(profile, {"output.masked": (site,)}))[site] == 0


def test_a_line_array_has_no_letters():
    with raises(ExperimentError, names="profile", value=1, allowed=4):
        draw_letter("A", load_profile("line-8"))


def test_letters_are_parsed():
    assert parse_letters(None) == ALPHABET
    assert parse_letters("a,e,A,u") == "AEU"


@pytest.mark.parametrize("text", ["A", "", "A1", "Ä,B"])
def test_what_is_no_list_of_letters(text):
    with raises(ExperimentError, names="letters", value=text):
        parse_letters(text)
