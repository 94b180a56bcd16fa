"""Braille at its true distances on the electrodes, and back from what was delivered."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import ReadingError
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import (
    CELL_MM,
    DOT_MM,
    Braille,
    Presentation,
    cell_layout,
)
from smarttouch.reading.delivered_lines import LineDelivery, deliver_pulses

from ..raising import raises
from ..whole import WHOLE, sample

ARRAYS = ["electric-mouse", "etactilekit-32", "optacon-24x6", "smarttouch-4x4"]


@cache
def array(name):
    profile = profile_for_reading(load_profile(name))
    return profile, load_bank(profile)


def test_on_a_grid_of_two_millimeters(reading):
    layout = cell_layout(reading)
    assert (layout.dot_x, layout.dot_y, layout.cell) == (1, 1, 3)


@pytest.mark.parametrize("name", ARRAYS)
def test_distances_are_the_nearest_that_electrodes_have(name):
    layout = cell_layout(load_profile(name))
    for count, wanted_mm, pitch_mm in (
        (layout.dot_x, DOT_MM, layout.pitch_mm[0]),
        (layout.dot_y, DOT_MM, layout.pitch_mm[1]),
        (layout.cell, CELL_MM, layout.pitch_mm[0]),
    ):
        assert abs(count * pitch_mm - wanted_mm) <= pitch_mm / 2


def test_each_dot_is_one_electrode(reading):
    layout = cell_layout(reading)
    line = layout.moving("⠓⠊")
    dots = line.image.reshape(8, 8, -1, 8).mean(axis=(1, 3)) < 128
    wanted = np.zeros((8, 6), bool)
    for row, column in ((2, 0), (3, 0), (3, 1), (3, 3), (2, 4)):
        wanted[row, column] = True
    np.testing.assert_array_equal(dots, wanted)
    assert set(np.unique(line.image)) == {0, 255}


def test_one_by_one_the_array_holds_one_cell_in_its_middle(reading):
    layout = cell_layout(reading)
    line = layout.one_by_one("⠿⠿⠿")
    assert line.image.shape[1] == 3 * reading.optics.sensor_columns
    columns = np.flatnonzero(line.image.min(axis=0) == 0) // 8
    assert sorted(set(columns)) == [3, 4, 11, 12, 19, 20]


cells = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x283F), min_size=1, max_size=12)
eight_dot = st.text(
    st.characters(min_codepoint=0x2800, max_codepoint=0x28FF), min_size=1, max_size=8
)


def delivered(name, line_cells, presentation):
    profile, bank = array(name)
    braille = Braille(presentation=presentation)
    layout = braille.layout(profile, line_cells)
    apart = presentation is Presentation.CELL
    line = layout.one_by_one(line_cells) if apart else layout.moving(line_cells)
    # One pulse for each place is enough for a machine; gaps need some more.
    motion = braille.motion(profile, profile.electrodes.cell_mm[0] * 20)
    picture = deliver_pulses(line, LineDelivery(profile, bank, braille.tone, motion)).picture
    return layout.decode(picture, line_cells, apart)


@pytest.mark.parametrize("presentation", Presentation)
@pytest.mark.parametrize("name", sample(ARRAYS))
@settings(max_examples=4 if WHOLE else 2, deadline=None)
@given(line=cells)
def test_what_is_delivered_is_what_was_asked_for(name, presentation, line):
    assert delivered(name, line, presentation) == line


@pytest.mark.parametrize("presentation", Presentation)
@settings(max_examples=4 if WHOLE else 2, deadline=None)
@given(line=eight_dot)
def test_so_are_cells_with_eight_dots(presentation, line):
    for name in ("electric-mouse", "optacon-24x6"):
        assert delivered(name, line, presentation) == line


def test_a_dot_that_was_not_delivered_is_missed():
    """The measure can fail."""
    profile, bank = array("electric-mouse")
    layout = cell_layout(profile)
    line = layout.moving("⠿⠿")
    line.image[:24] = 255
    braille = Braille()
    picture = deliver_pulses(
        line, LineDelivery(profile, bank, braille.tone, braille.motion(profile))
    ).picture
    assert layout.decode(picture, "⠿⠿", apart=False) == "⠶⠶"


@pytest.mark.parametrize(("name", "attributes"), [
    ("line-7", {"value": (1, 7), "allowed": (3, 3)}), ("kajimoto-61", {"value": "kajimoto-61"}),
    ("line-8", {"value": (1, 8)}),
])  # fmt: skip
def test_arrays_without_room_are_named(name, attributes):
    with raises(ReadingError, **attributes):
        cell_layout(load_profile(name))
