"""Answers from our files and from those of others."""

import numpy as np
import pytest

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.answers import read_table

from ...raising import raises
from ..psychophysics.test_answer_file import ROW, written


def file(tmp_path, text):
    path = tmp_path / "own.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_our_own(tmp_path):
    rows = [
        ROW | {"standard": standard, "success": success, "comparison_interval": interval}
        for standard in (45.0, 30.0)
        for success, interval in ((True, 1), (False, 2), (None, 1))
    ]
    table = read_table(written(tmp_path / "RA.csv", rows))
    assert (table.name, table.unit) == ("RA", "Hz")
    assert [each.standard for each in table.answers] == [30, 45]
    for each in table.answers:
        assert each.comparison.tolist() == [39, 39, 39]
        assert each.success[:2].tolist() == [1, 0]
        assert np.isnan(each.success[2])
        assert each.interval.tolist() == [1, 2, 1]
        assert each.alternatives == 2
        assert (each.presented, each.answered) == (3, 2)
        # Judged higher in the first, not judged higher in the second: the first both times.
        assert each.chosen() == (2, 0)
        assert [part.tolist() for part in each.counts()] == [[39], [2], [1]]


def test_a_cut_line_is_dropped(tmp_path):
    path = written(tmp_path / "a.csv", [ROW, ROW])
    path.write_bytes(path.read_bytes()[:-20])
    assert read_table(path).answers[0].presented == 1


@pytest.mark.parametrize(("text", "comparison", "success"), [
    ("comparison,success\n1.5,1\n2,0\n", [1.5, 2], [1, 0]),
    ("comparison;success\r\n1,5;yes\r\n2;No\r\n", [1.5, 2], [1, 0]),
    ("comparison\tsuccess\n1.5\tTrue\n2\tFALSE", [1.5, 2], [1, 0]),
    ("\ufeffid, comparison ,success\n7, 1.5 ,correct\n\n8,2, wrong\n", [1.5, 2], [1, 0]),
])  # fmt: skip
def test_others(tmp_path, text, comparison, success):
    (answers,) = read_table(file(tmp_path, text)).answers
    assert (answers.standard, answers.alternatives) == (0, 0)
    assert answers.comparison.tolist() == comparison
    assert answers.success.tolist() == success
    assert not answers.interval.any()


def test_columns_by_name(tmp_path):
    path = file(tmp_path, "hz,key_resp.corr,base\n33,1,30\n50,0,45\n40,None,30\n")
    table = read_table(path, x="hz", y="key_resp.corr", standard="base")
    assert [each.comparison.tolist() for each in table.answers] == [[33, 40], [50]]
    assert table.answers[0].answered == 1


@pytest.mark.parametrize(("responses", "alternatives"), [
    ("y n y", 0), ("1 2 1", 2), ("1 1 1", 2), ("A B C", 3),
])  # fmt: skip
def test_alternatives(tmp_path, responses, alternatives):
    lines = "".join(f"1,1,{each}\n" for each in responses.split())
    (answers,) = read_table(file(tmp_path, "comparison,success,response\n" + lines)).answers
    assert answers.alternatives == alternatives


@pytest.mark.parametrize(("text", "attributes", "line"), [
    ("", {}, None),
    ("comparison,success\n", {}, None),
    (
        "a,success\n1,1\n",
        {"names": "x", "value": "comparison", "allowed": ("a", "success")},
        None,
    ),
    ("comparison,b\n1,1\n", {"names": "y", "value": "success"}, None),
    ("comparison,success\n1,1\nx,1\n", {"names": "comparison", "value": "x"}, 3),
    ("comparison,success\n1,0.7\n", {"names": "success", "value": "0.7"}, 2),
    ("comparison,success\n1\n1,1\n", {"names": "line", "value": 1, "allowed": 2}, 2),
    ("comparison,success\ninf,1\n", {"names": "comparison", "value": "inf"}, 2),
    (b"\xff\xfe", {}, None),
    ('comparison,success\n"1,1\n', {}, None),
])  # fmt: skip
def test_errors(tmp_path, text, attributes, line):
    path = file(tmp_path, text)
    with raises(ExperimentError, **attributes) as caught:
        read_table(path)
    assert str(path) in str(caught.value)
    if line is not None:
        assert f"line {line}:" in str(caught.value)


def test_no_file_and_no_standard(tmp_path):
    with raises(ExperimentError, value=tmp_path / "none.csv"):
        read_table(tmp_path / "none.csv")
    with raises(ExperimentError, names="standard", value="base"):
        read_table(file(tmp_path, "comparison,success\n1,1\n"), standard="base")
