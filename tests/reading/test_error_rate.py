"""Rates of error: known ones, and what holds for all texts."""

import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import ReadingError
from smarttouch.reading.legibility import character_error_rate, normalize

from ..raising import raises

texts = st.text(max_size=30)


@pytest.mark.parametrize(("truth", "text", "rate"), [
    ("touch", "touch", 0), ("touch", "touches", 2 / 5), ("finger tip", "finger lip", 1 / 10),
    ("finger tip", "fingertip", 1 / 10), ("finger tip", "", 1), ("a", "aaaa", 3),
    ("Case counts", "case counts", 1 / 11),
])  # fmt: skip
def test_known_rates(truth, text, rate):
    assert character_error_rate(truth, text) == pytest.approx(rate)


@pytest.mark.parametrize(("one", "other"), [
    ("“so”, ‘he’ said", "\"so\", 'he' said"),
    ("„so“ «so»", '"so" "so"'),
    ("don´t", "don't"),
    ("1914–18 — a war", "1914-18 - a war"),
    ("a\N{SOFT HYPHEN}way", "away"),
    ("ﬁnal oﬃce", "final office"),
    ("and so on…", "and so on..."),
    ("e\N{COMBINING ACUTE ACCENT}te", "éte"),
    (" two\n\nlines\t\N{NO-BREAK SPACE}of text ", "two lines of text"),
])  # fmt: skip
def test_what_makes_no_difference(one, other):
    assert normalize(one) == normalize(other) == other
    assert character_error_rate(one, other) == 0


@pytest.mark.parametrize("truth", ["", " \n\t"])
def test_there_must_be_a_truth(truth):
    with raises(ReadingError):
        character_error_rate(truth, "text")


@given(texts)
def test_normalizing_twice_changes_nothing_more(text):
    assert normalize(normalize(text)) == normalize(text)


@given(texts.filter(normalize))
def test_equal_texts_have_no_errors(text):
    assert character_error_rate(text, text) == 0


def test_without_the_extra_it_says_which(monkeypatch):
    for name in ("rapidfuzz", "rapidfuzz.distance", "rapidfuzz.distance.Levenshtein"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ReadingError) as caught:
        character_error_rate("a", "b")
    assert "smarttouch[legibility]" in str(caught.value)
