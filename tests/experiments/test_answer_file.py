"""Files of answers survive crashes and spreadsheets; files of other programs are read, too."""

import os
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base import __version__
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.answer_file import COLUMNS, AnswerFile, read_table

from ..support.checks import raises
from .simulated import read_rows

ABOUT = {"experiment": "frequency", "procedure": "constant", "participant": "p1", "session": "1",
         "seed": 7}  # fmt: skip
ROW = dict(zip(COLUMNS, (
    0, 3, 3, 12, "frequency", "constant", 30.0, 39.0, 2, "Hz", "2", "1", False, 0.84, 61.5, 0.7,
    "p1", "1", "2026-01-02 10:00", 7, 200.0, __version__,
), strict=True))  # fmt: skip

_words = st.text(st.characters(blacklist_categories=("Cs", "Cc")), max_size=8)
_numbers = st.floats(allow_nan=False, allow_infinity=False)
_rows = st.fixed_dictionaries({
    "thisN": st.integers(0, 10**6), "standard": st.none() | _numbers, "comparison": _numbers,
    "comparison_interval": st.sampled_from([None, 1, 2]), "target": _words, "response": _words,
    "success": st.sampled_from([None, True, False]), "rt": st.none() | _numbers,
    "time_s": _numbers, "frameRate": st.none() | _numbers,
}).map(lambda some: ROW | some)  # fmt: skip


def written(path, rows):
    with AnswerFile(path, ABOUT) as file:
        for row in rows:
            file.append(row)
    return path


def test_columns_as_psychopy_has_them(tmp_path):
    lines = written(tmp_path / "a.csv", [ROW]).read_bytes().split(b"\n")
    assert lines[0] == (
        b"\xef\xbb\xbfthisRepN,thisTrialN,thisN,thisIndex,experiment,procedure,standard,comparison,"
        b"comparison_interval,unit,target,response,success,rt,time_s,level,participant,session,"
        b"date,seed,frameRate,version"
    )
    assert lines[1] == (
        b"0,3,3,12,frequency,constant,30.0,39.0,2,Hz,2,1,0,0.84,61.5,0.7,p1,1,"
        b"2026-01-02 10:00,7,200.0," + __version__.encode()
    )
    assert lines[2:] == [b""]


@settings(deadline=None)
@given(st.lists(_rows, min_size=1, max_size=4), st.data())
def test_cut_anywhere_loses_the_cut_line_alone(tmp_path_factory, rows, data):
    path = written(tmp_path_factory.mktemp("rows") / "a.csv", rows)
    whole = path.read_bytes()
    cut = whole[: data.draw(st.integers(0, len(whole)) | st.integers(-12, -1))]
    path.write_bytes(cut)
    with AnswerFile(path, ABOUT) as file:
        kept = len(file.rows)
        # A line is complete if it has all cells, even without its line end.
        assert kept in {max(cut.count(b"\n") - 1, 0), cut.count(b"\n")}
        for row in rows[kept:]:
            file.append(row)
    assert read_rows(path) == rows
    assert path.read_bytes().startswith(cut[: cut.rfind(b"\n") + 1])


SHEETS = {
    "carriage returns": (",", ".", "\r", True),
    "Windows": (",", ".", "\r\n", True),
    "German": (";", ",", "\r\n", True),
    "tabs": ("\t", ",", "\n", True),
    "no newline at the end": (",", ".", "\n", False),
    "no carriage return at the end": (",", ".", "\r", False),
}


@pytest.mark.parametrize("name", SHEETS)
def test_what_a_spreadsheet_saves_is_read_and_continued(tmp_path, name):
    delimiter, point, line_end, ended = SHEETS[name]
    path = written(tmp_path / "a.csv", [ROW, ROW])
    lines = path.read_text("utf-8-sig").splitlines()
    table = [[cell.replace(".", point) for cell in line.split(",")] for line in lines]
    table[1:] = [[*cells[:-1], __version__] for cells in table[1:]]
    text = line_end.join(delimiter.join(cells) for cells in table) + line_end * ended
    path.write_bytes(text.encode())
    with AnswerFile(path, ABOUT) as file:
        assert file.rows == [ROW, ROW]
        file.append(ROW)
    assert read_rows(path) == [ROW] * 3
    assert path.read_bytes().startswith(text.encode())
    assert path.read_bytes().endswith(line_end.encode())
    assert read_table(path).answers[0].presented == 3


@pytest.mark.parametrize("content", [
    "a note of one line", "a,b\r1,2\r", "1.5,2\n", "{head}\n0,3,x", "{head};more\n0;3",
])  # fmt: skip
def test_nothing_that_others_wrote_is_removed(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_text(content.replace("{head}", ",".join(COLUMNS)))
    before = path.read_bytes()
    with pytest.raises(ExperimentError, match=re.escape(str(path))):
        AnswerFile(path, ABOUT)
    assert path.read_bytes() == before


def test_each_row_is_on_disk_before_append_returns(tmp_path, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda file: (real(file), synced.append(path.read_bytes().count(b"\n")))
    )
    path = tmp_path / "a.csv"
    with AnswerFile(path, ABOUT) as file:
        for count in range(3):
            file.append(ROW)
            assert synced[-1] == count + 2


@pytest.mark.parametrize(("name", "wanted"), [
    ("experiment", "detection"), ("procedure", "staircase"), ("participant", "p2"),
    ("session", "2"), ("seed", 8),
])  # fmt: skip
def test_no_other_session_goes_on(tmp_path, name, wanted):
    path = written(tmp_path / "a.csv", [ROW])
    before = path.read_bytes()
    with raises(ExperimentError, names=name, value=ABOUT[name], allowed=wanted):
        AnswerFile(path, ABOUT | {name: wanted})
    assert path.read_bytes() == before
    # The refusal leaves no lock on the file.
    with AnswerFile(path, ABOUT) as file:
        assert file.rows == [ROW]


@pytest.mark.parametrize("change", [{"level": float("nan")}, {"target": "a\nb"}])
def test_what_no_cell_can_hold(tmp_path, change):
    path = written(tmp_path / "a.csv", [ROW])
    (name,) = change
    with AnswerFile(path, ABOUT) as file, raises(ExperimentError, names=name):
        file.append(ROW | change)
    assert read_rows(path) == [ROW]


def test_nobody_else_writes_a_file_meanwhile(tmp_path):
    path = written(tmp_path / "a.csv", [ROW])
    with AnswerFile(path, ABOUT) as file:
        file.append(ROW)
        for taken in (path, tmp_path / "none" / "a.csv"):
            with raises(ExperimentError, names="file", value=taken):
                AnswerFile(taken, ABOUT)
    assert read_rows(path) == [ROW, ROW]


def saved(tmp_path, text):
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
        # Interval 1 was chosen twice: correctly in the first trial, wrongly in the second.
        assert each.chosen() == (2, 0)
        assert [part.tolist() for part in each.counts()] == [[39], [2], [1]]


@pytest.mark.parametrize(("text", "comparison", "success"), [
    ("comparison,success\n1.5,1\n2,0\n", [1.5, 2], [1, 0]),
    ("comparison;success\r\n1,5;yes\r\n2;No\r\n", [1.5, 2], [1, 0]),
    ("comparison\tsuccess\n1.5\tTrue\n2\tFALSE", [1.5, 2], [1, 0]),
    ("\ufeffid, comparison ,success\n7, 1.5 ,correct\n\n8,2, wrong\n", [1.5, 2], [1, 0]),
])  # fmt: skip
def test_others(tmp_path, text, comparison, success):
    (answers,) = read_table(saved(tmp_path, text)).answers
    assert (answers.standard, answers.alternatives) == (0, 0)
    assert answers.comparison.tolist() == comparison
    assert answers.success.tolist() == success
    assert not answers.interval.any()


def test_columns_by_name(tmp_path):
    path = saved(tmp_path, "hz,key_resp.corr,standard\n33,1,30\n50,0,45\n40,None,30\n")
    table = read_table(path, x="hz", y="key_resp.corr")
    assert [each.comparison.tolist() for each in table.answers] == [[33, 40], [50]]
    assert table.answers[0].answered == 1


@pytest.mark.parametrize(("responses", "alternatives"), [
    ("y n y", 0), ("1 2 1", 2), ("1 1 1", 2), ("A B C", 3),
])  # fmt: skip
def test_alternatives(tmp_path, responses, alternatives):
    lines = "".join(f"1,1,{each}\n" for each in responses.split())
    (answers,) = read_table(saved(tmp_path, "comparison,success,response\n" + lines)).answers
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
def test_what_is_no_file_of_answers(tmp_path, text, attributes, line):
    path = saved(tmp_path, text)
    with raises(ExperimentError, **attributes) as caught:
        read_table(path)
    assert str(path) in str(caught.value)
    if line is not None:
        assert f"line {line}:" in str(caught.value)
