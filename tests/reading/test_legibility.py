"""Letter shapes on electrodes, character error rates, and pictures of delivered pulses."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ExperimentError, ReadingError
from smarttouch.imaging.image_reconstruction import PIXELS_PER_PITCH
from smarttouch.imaging.reading_profile import usual_speed_mm_s
from smarttouch.imaging.tactile_mapper import Tone
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.legibility import (
    LineDelivery,
    character_error_rate,
    deliver_lines,
    deliver_pulses,
    letter_sequences,
    normalize,
)
from smarttouch.reading.letter_shapes import ALPHABET, draw_letter
from smarttouch.reading.line_source import LineMotion
from smarttouch.stimulation.scan_sequence import SlotPolicy

from ..support.checks import raises


def test_all_letters_differ(profile):
    drawn = np.array([draw_letter(each, profile) for each in ALPHABET])
    apart = (drawn[:, None] != drawn[None]).sum(axis=2)
    assert apart[~np.eye(26, dtype=bool)].min() >= 4
    assert set(np.unique(drawn)) == {0.0, 1.0}
    # All letters are 8 electrodes high, except W, which is 8 electrodes wide.
    rows = drawn.reshape(26, 8, 8).any(axis=2).sum(axis=1)
    assert rows.min() >= 6
    assert (rows == 8).sum() == 25


def test_masked_electrodes_draw_nothing(profile, changed):
    site = int(np.flatnonzero(draw_letter("E", profile))[0])
    assert draw_letter("E", changed(profile, {"output.masked": (site,)}))[site] == 0


def test_a_line_array_has_no_letters():
    with raises(ExperimentError, names="profile", value=1, allowed=4):
        draw_letter("A", load_profile("line-8"))


GRADED = Tone(0.0, 1.0, prepared=True)


@pytest.mark.parametrize(("truth", "text", "rate"), [
    ("touch", "touch", 0), ("touch", "touches", 2 / 5), ("finger tip", "finger lip", 1 / 10),
    ("finger tip", "fingertip", 1 / 10), ("finger tip", "", 1), ("a", "aaaa", 3),
    ("Case counts", "case counts", 1 / 11),
])  # fmt: skip
def test_known_rates(truth, text, rate):
    assert character_error_rate(truth, text) == pytest.approx(rate)


@pytest.mark.parametrize(("one", "other"), [
    ("“so”, ‘he’ said", "\"so\", 'he' said"), ("„so“ «so»", '"so" "so"'), ("don´t", "don't"),
    ("1914–18 — a war", "1914-18 - a war"), ("a\N{SOFT HYPHEN}way", "away"),
    ("ﬁnal oﬃce", "final office"), ("and so on…", "and so on..."),
    ("e\N{COMBINING ACUTE ACCENT}te", "éte"),
    (" two\n\nlines\t\N{NO-BREAK SPACE}of text ", "two lines of text"),
])  # fmt: skip
def test_what_makes_no_difference(one, other):
    assert normalize(one) == normalize(other) == other
    assert character_error_rate(one, other) == 0


def test_there_must_be_a_truth_and_the_extra(monkeypatch):
    with raises(ReadingError):
        character_error_rate(" \n\t", "text")
    for name in ("rapidfuzz", "rapidfuzz.distance", "rapidfuzz.distance.Levenshtein"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ReadingError, match=r"smarttouch\[legibility\]"):
        character_error_rate("a", "b")


@pytest.fixture
def way(reading, reading_bank):
    return LineDelivery(reading, reading_bank, GRADED, LineMotion(usual_speed_mm_s(reading)))


def felt_along(picture):
    """Return the position of each column of a picture, in mm, and the mean of each column."""
    values = picture.values()
    return (np.arange(values.shape[1]) + 0.5) * 2.0 / PIXELS_PER_PITCH, values.mean(axis=0)


def test_bars_are_felt_where_they_are(way, make_line):
    bars = [(10.0, 16.0), (0.0, 10.0)]
    first, second = (
        each.picture for each in deliver_lines([make_line(30, bar) for bar in bars], way)
    )
    x_mm, felt = felt_along(first)
    assert felt[(x_mm > 12) & (x_mm < 14)].min() > 0.9
    assert felt[(x_mm < 7) | (x_mm > 19)].max() < 0.1
    assert (x_mm * felt).sum() / felt.sum() == pytest.approx(13.0, abs=0.2)
    # The pose of a lifted finger is x = 0. Its frames must not weaken the picture near x = 0.
    # Felt values are slightly below 1 because currents are rounded to whole microamperes.
    x_mm, felt = felt_along(second)
    assert felt[(x_mm > 3) & (x_mm < 5)].min() > 0.99


def test_many_points_in_a_slot_are_felt_as_they_are_one_by_one(way, make_line):
    line = make_line(20.0, (6.0, 9.0))
    by_points = deliver_pulses(line, way).picture.values()
    shared = replace(way, sharing=SlotPolicy((Afferent.RA,)))
    at_once = deliver_pulses(line, shared).picture.values()
    # Currents of a shared slot can be 4 % low: 8 % of the range from threshold (half) to full.
    assert np.abs(at_once - by_points).max() < 0.12
    assert not np.array_equal(at_once, by_points)


@pytest.fixture(scope="module")
def shown():
    """Return a profile, and the scan sequences of its letters L and T in RA mode."""
    profile = load_profile("smarttouch-4x4")
    return profile, letter_sequences("LT", profile, load_bank(profile), Mode.RA)


def test_a_letter_is_given_at_full_comfort(shown):
    profile, letters = shown
    for sequence, active in letters.values():
        assert sequence.intensity == 1
        assert active.any()
        full_ua = 1000 * profile.full_ma.max()
        assert abs(sequence.current_ua).max() == pytest.approx(full_ua, rel=0.01)
