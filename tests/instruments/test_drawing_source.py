"""Drawings: what pages ask for comes out, is listed, played, saved and read again."""

import base64
import json
import math

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import ScheduleError, SourceError
from smarttouch.instruments.drawing_source import (
    LONGEST_MS,
    DrawSource,
    Pattern,
    library,
    open_draw,
    read_patterns,
    write_patterns,
)
from smarttouch.reading.letter_shapes import draw_letter

from ..raising import raises


@pytest.fixture
def source(profile):
    return DrawSource(profile)


def level_of(*electrodes, count=64):
    level = np.zeros(count, np.uint8)
    level[[*electrodes]] = 255
    return base64.b64encode(level.tobytes()).decode()


def felt(source, time_ns=0):
    """Return which electrodes are active at a time."""
    return np.flatnonzero(source.read(time_ns).activation[0]).tolist()


def test_what_is_painted_is_felt(source):
    assert felt(source) == []
    source.draw(f"level {level_of(3, 20)}")
    assert felt(source) == [3, 20]
    stimulus = source.read(0)
    assert stimulus.activation.max() == 1
    assert stimulus.force_n > 0
    assert source.frames == 2


def test_a_letter(source, profile):
    source.draw("letter H")
    np.testing.assert_array_equal(source.read(0).activation[0], draw_letter("H", profile))


@pytest.mark.parametrize("words", [
    "", "level", "level AAAA", "level %", "letter", "letter AB", "letter  ", "library", "library x",
    "keep", "keep 0", "keep -5", "keep 1e9", "keep ²", "show 0", "drop 0", "show x", "play",
    "play often", "halt now", "save exe", "close", "read", "add", "_level", "do_level x",
])  # fmt: skip
def test_what_is_no_drawing_is_refused(source, words):
    with pytest.raises(ValueError):
        source.draw(words)
    assert felt(source) == []
    assert source.patterns == []


def test_a_list_is_played(source):
    for electrode, lasts in ((1, 100), (2, 200), (3, 100)):
        source.draw(f"level {level_of(electrode)}")
        source.draw(f"keep {lasts}")
    source.draw("play once")
    at = [felt(source, 1_000_000 * ms) for ms in (1000, 1099, 1100, 1299, 1300, 1399, 1400, 1500)]
    assert at == [[1], [1], [2], [2], [3], [3], [], []]
    source.draw("play loop")
    at = [felt(source, 1_000_000 * ms) for ms in (2000, 2150, 2350, 2400, 2550)]
    assert at == [[1], [2], [3], [1], [2]]
    source.draw("halt")
    assert felt(source, 10**10) == []
    source.draw("show 2")
    assert felt(source, 10**10) == [3]
    source.draw("drop 0")
    assert [each.duration_ms for each in source.patterns] == [200, 100]


def test_nothing_is_played_of_an_empty_list(source):
    source.draw("play loop")
    assert felt(source, 10**9) == []
    assert source.message()["playing"] is None


def test_a_saved_list_is_read_again(source, profile, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for electrode in (1, 9):
        source.draw(f"level {level_of(electrode)}")
        source.draw("keep 250")
    for _ in range(2):
        source.draw("save")
    assert {each.name for each in tmp_path.iterdir()} == {"drawing-1.json", "drawing-2.json"}
    document = json.loads((tmp_path / "drawing-1.json").read_text())
    assert [each["time_ms"] for each in document["steps"]] == [0, 250]
    again = open_draw("drawing-2.json", profile)
    assert [each.duration_ms for each in again.patterns] == [250, 250]
    for before, after in zip(source.patterns, again.patterns, strict=True):
        np.testing.assert_array_equal(before.level, after.level)


def test_what_cannot_be_saved_is_reported(source, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "smarttouch.instruments.drawing_source._free_name", lambda: tmp_path / "gone" / "a.json"
    )
    source.draw("save")
    assert "gone" in source.message()["said"]


@pytest.mark.parametrize("text", [
    "", "[]", "{}", '{"steps": [], "electrodes": []}', "[" * 100_000,
    '{"steps": [{"time_ms": 0, "activation": [2]}], "electrodes": [{"x_mm": 0, "y_mm": 0}]}',
    '{"steps": [{"time_ms": 0, "activation": ["a"]}], "electrodes": [{"x_mm": 0, "y_mm": 0}]}',
    *(json.dumps({
        "steps": [{"time_ms": each, "activation": [1]} for each in times_ms],
        "electrodes": [{"x_mm": 0, "y_mm": 0}],
    }) for times_ms in ([0, math.nan], [0, math.inf], [0, 0], [0, -20], [[0], [1]], [0, 10**400],
                        [0, 1e9])),
])  # fmt: skip
def test_a_file_of_something_else_is_refused(profile, tmp_path, text):
    path = tmp_path / "a.json"
    path.write_text(text)
    with raises(SourceError, about="file", value=path):
        read_patterns(path, profile)


def test_what_is_written_lasts_as_long_as_it_did(profile, tmp_path):
    path = tmp_path / "a.json"
    patterns = [Pattern(np.zeros(64, np.uint8), 5)] * 500
    write_patterns(path, profile, patterns)
    assert {each.duration_ms for each in read_patterns(path, profile)} == {5}
    write_patterns(path, profile, [*patterns, patterns[0]])
    with raises(SourceError, about="file", value=501, allowed=500):
        read_patterns(path, profile)


def test_the_loop_does_not_wait_for_a_letter(source, monkeypatch):
    def letter(*_):
        assert not source._lock.locked()
        return np.ones(64)

    monkeypatch.setattr("smarttouch.instruments.drawing_source.draw_letter", letter)
    source.draw("letter H")
    assert len(felt(source)) == 64


def test_a_file_that_is_missing_or_of_another_array_is_refused(
    source, profile, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with raises(SourceError, about="file"):
        st.open_source("draw:none.json", profile)
    source.draw("save")
    with raises(SourceError, about="profile", value=64, allowed=61):
        st.open_source("draw:drawing-1.json", st.load_profile("kajimoto-61"))


@pytest.mark.parametrize("name", st.list_profiles())
def test_the_library_is_for_every_array(name):
    profile = st.load_profile(name)
    patterns = library(profile.electrodes)
    for each in patterns.values():
        assert all(one.level.any() for one in each)
        assert all(one.level.shape == (len(profile.electrodes),) for one in each)
    source = DrawSource(profile)
    for name, each in patterns.items():
        source.draw(f"library {name}")
        np.testing.assert_array_equal(source.read(0).activation[1] * 255, each[0].level)
    assert len(source.patterns) == sum(len(each) for each in patterns.values() if len(each) > 1)


def test_a_list_does_not_grow_without_end(source):
    source.patterns = [Pattern(np.zeros(64, np.uint8), LONGEST_MS)] * 500
    source.draw("keep 500")
    assert len(source.patterns) == 500
    assert source.message()["said"]


def test_all_classes_at_once_need_periods_that_drawings_have_not():
    with raises(ScheduleError, about="mode"):
        st.run("draw:", "simulated:", mode="color", seconds=0.2)
