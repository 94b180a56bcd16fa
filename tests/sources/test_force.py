"""Force that a person states."""

import pytest

from smarttouch.base.errors import SourceError
from smarttouch.sources.force import open_force

from ..raising import raises


@pytest.mark.parametrize(("text", "force_n"), [("0", 0), ("0.5", 0.5), ("20", 20)])
def test_fixed_force(profile, text, force_n):
    with open_force(f"fixed:{text}", profile) as source:
        assert source.read(0) == source.read(10**12) == force_n
        assert source.title == f"fixed {force_n:g} N"
        assert source.notes == []


@pytest.mark.parametrize("text", ["", "x", "-0.1", "20.1", "nan", "inf", "0.5 N"])
def test_what_is_no_fixed_force(profile, text):
    with raises(SourceError, names="force", value=text, allowed=20):
        open_force(f"fixed:{text}", profile)
    known = ("fixed", "hx711", "loadcell")
    with raises(SourceError, names="force", value="spring:1", allowed=known):
        open_force("spring:1", profile)
