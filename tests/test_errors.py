"""Checks that numbers are in their ranges, and names among their choices."""

import math

import pytest

from smarttouch.errors import SourceError, not_offered, require_within

from .raising import assert_says, raises


@pytest.mark.parametrize("value", [1, 2.5, 4])
def test_a_number_in_its_range(value):
    require_within(SourceError, "rate_hz", value, 1, 4)


@pytest.mark.parametrize("value", [0.999, 4.001, -math.inf, math.inf])
def test_a_number_out_of_its_range(value):
    with raises(SourceError, about="rate_hz", value=value, allowed=(1, 4)):
        require_within(SourceError, "rate_hz", value, 1, 4)


def test_what_is_no_number_is_in_no_range():
    with raises(SourceError, about="rate_hz", value=math.nan):
        require_within(SourceError, "rate_hz", math.nan, -math.inf, math.inf)


def test_a_range_without_its_lower_end():
    require_within(SourceError, "seconds", 1e-9, 0, 1, above=True)
    with raises(SourceError, about="seconds", value=0):
        require_within(SourceError, "seconds", 0, 0, 1, above=True)


def test_a_name_that_is_none_of_the_choices():
    error = not_offered("scan", "all", iter(["points", "auto"]), SourceError)
    assert type(error) is SourceError
    assert_says(error, about="scan", value="all", allowed=("points", "auto"))
