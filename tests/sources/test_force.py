"""Force that is fixed or recorded."""

import math

import pytest

from smarttouch.base.errors import SourceError
from smarttouch.sources.force import open_force

from ..raising import raises

HEADER = "time_s,force_n\n"
SECOND = 10**9


@pytest.fixture
def recorded(tmp_path, profile):
    def make(text):
        file = tmp_path / "force.csv"
        file.write_text(text, encoding="utf-8")
        return open_force(f"recorded:{file}", profile)

    return make


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
    known = ("fixed", "hx711", "loadcell", "recorded")
    with raises(SourceError, names="force", value="spring:1", allowed=known):
        open_force("spring:1", profile)


def test_recorded_force_is_interpolated_and_unknown_outside(recorded):
    source = recorded("\ufefftime_s, force_n\n1,0.2\n\n2,0.4\n4,-0.5\n")
    assert source.read(SECOND) == 0.2
    assert source.read(SECOND * 3 // 2) == pytest.approx(0.3)
    assert source.read(SECOND * 4) == 0.0, "no finger pulls"
    assert math.isnan(source.read(SECOND - 1))
    assert math.isnan(source.read(4 * SECOND + 1))


def test_a_recorded_path_is_a_recorded_force_too(recorded):
    source = recorded("time_s,x_mm,y_mm,angle_deg,force_n\n0,0,0,0,0\n1,9,9,9,1\n")
    assert source.read(SECOND // 4) == 0.25


@pytest.mark.parametrize(("text", "about", "value"), [
    ("0,1\n1,2\n", "columns", ("0", "1")), (HEADER + "0,1\n", "rows", 1),
    (HEADER + "0,1\n1,x\n", "line", 3), (HEADER + "0,1\n1,150\n", "force_n", 150),
])  # fmt: skip
def test_bad_records(recorded, text, about, value):
    allowed = ("time_s", "force_n") if about == "columns" else None
    with raises(SourceError, value=value, allowed=allowed) as caught:
        recorded(text)
    assert "force.csv" in str(caught.value)
    assert about != "force_n" or "line 3" in str(caught.value)


def test_no_record(tmp_path, profile):
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.csv", tmp_path, binary):
        with raises(SourceError, value=path):
            open_force(f"recorded:{path}", profile)
