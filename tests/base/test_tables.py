"""Columns of numbers by their names, and errors by their lines."""

import math

import pytest

from smarttouch.base.errors import SourceError
from smarttouch.base.files import finite, read_csv

from ..support.checks import raises


@pytest.fixture
def table(tmp_path):
    def make(text):
        path = tmp_path / "a.csv"
        path.write_text(text, encoding="utf-8", newline="")
        return read_csv(path, SourceError)

    return make


def test_columns_come_in_the_order_asked_and_others_are_not_used(table):
    read = table("\ufeff\nb, note ,a\r\n1, x,2\r\n\r\n , ,\r\n3,,4,\r\n")
    assert read.head == ("b", "note", "a")
    assert read.numbers(("a", "b")).tolist() == [[2, 1], [4, 3]]
    assert read.lines == [3, 6]
    assert read.rows[0] == ["1", " x", "2"]


def test_a_quoted_cell_may_go_over_lines(table):
    read = table('a,note\n1,"x\ny"\n2,z\n')
    assert read.lines == [3, 4]


@pytest.mark.parametrize(("text", "about", "value"), [
    ("", "columns", ()), ("a,c\n1,2\n", "columns", ("a", "c")), ("a,b\n1,2\n", "rows", 1),
    ("a,b\n1,2\n\n2\n", "line", 4), ("a,b\n1,2\n2,\n", "line", 3),
    ("a,b\n1,2\n2,1e999\n", "line", 3), ("a,b\n0,5,1\n", "line", 2),
    ("a,b\n1,2\n3,4\n3,5\n", "line", 4),
])  # fmt: skip
def test_errors_are_reported_with_their_line(table, text, about, value):
    with raises(SourceError, names=about, value=value):
        table(text).numbers(("a", "b"))


def test_columns_need_not_rise(table):
    assert table("a,b\n2,0\n1,0\n").numbers(("a", "b"), rising=False)[:, 0].tolist() == [2, 1]


@pytest.mark.parametrize("text", ["", "x", "nan", "-inf", "1,5"])
def test_what_is_no_finite_number(text):
    assert math.isnan(finite(text))
    assert finite(" -1.5 ") == -1.5
