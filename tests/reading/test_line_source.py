"""Source of lines: motion under the finger, keys, and preparation of lines in a thread."""

import math
import threading

import numpy as np
import pytest

from smarttouch.base.errors import ReadingError
from smarttouch.imaging.reading_profile import (
    pixel_pitch_mm,
    reading_force_n,
)
from smarttouch.reading.line_source import (
    AHEAD,
    BEHIND,
    LAND_S,
    SETTLE_S,
    LineMotion,
    ReadingSource,
    TouchLine,
)

from ..support.checks import raises

MS = 1_000_000
MOTION = LineMotion(25.0)


@pytest.fixture
def source_of(reading):
    """Return a function that makes a `ReadingSource` of lines; teardown closes the sources."""
    opened = []

    def make(*lines, motion=MOTION, pause_s=0.0):
        lines = lines[0] if len(lines) == 1 and not isinstance(lines[0], TouchLine) else iter(lines)
        opened.append(ReadingSource("a page", reading, lines, motion, pause_s))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


def frames_of(source, step_ms=20, max_steps=2000):
    """Read all frames; return (time in seconds, index of the line, frame) of each."""
    found = []
    for step in range(max_steps):
        index = source.index
        frame = source.read(step * step_ms * MS)
        if frame is None:
            return found
        found.append((step * step_ms / 1000, index, frame))
    raise AssertionError(f"the source has not ended after {max_steps} frames")


def test_a_line_is_swept_from_before_its_start_to_after_its_end(reading, source_of, make_line):
    line, pixel_mm = make_line(30.0), pixel_pitch_mm(reading)
    source = source_of(line)
    source.line(1, wait=True)
    frames = [(time_s, frame) for time_s, _, frame in frames_of(source)]
    passed = [each for each in frames if each[0] <= SETTLE_S + 46 / 25]
    assert passed[0][1].pose.x_mm == line.start_mm
    assert passed[-1][1].pose.x_mm == pytest.approx(line.end_mm, abs=0.6)
    columns = (np.arange(64) + 0.5 - 32) * pixel_mm
    for time_s, frame in passed:
        x_mm = line.start_mm + max(0.0, time_s - SETTLE_S) * 25.0
        assert frame.pose.x_mm == pytest.approx(x_mm)
        assert frame.force_n == (reading_force_n(reading) if time_s >= LAND_S else 0.0)
        ink = (x_mm + columns > 10.25) & (x_mm + columns < 13.75)
        assert (frame.image[8][ink] < 128).all()
    # A point marks the start: its pulses raise the intensity before the first letters arrive.
    dark = [(frames[0][1].image == 0).any(axis=axis).sum() for axis in (0, 1)]
    assert dark == pytest.approx([side / pixel_mm for side in reading.electrodes.cell_mm], abs=1)
    assert (frames[int(SETTLE_S / 0.02) + 2][1].image == 255).all()


def test_between_lines_it_is_lifted_for_as_long_as_asked(source_of, make_line):
    source = source_of(make_line(10.0), make_line(10.0), motion=LineMotion(50.0), pause_s=0.5)
    source.line(2, wait=True)
    frames = frames_of(source)
    lifted = [each for each in frames if each[0] > 1 and each[2].force_n == 0 and each[1] == 0]
    assert lifted[-1][0] - lifted[0][0] == pytest.approx(0.5, abs=0.05)
    assert all((frame.image == 255).all() for *_, frame in lifted)
    heights = {frame.pose.y_mm for *_, frame in frames}
    assert heights == {0, source.line_step_mm}
    assert source.line_step_mm > 16.0
    assert [frame.number for *_, frame in frames] == list(range(source.frames))


def test_keys_go_forward_back_and_again(source_of, make_line):
    source = source_of(*[make_line(text=each) for each in "abcd"])
    source.line(4, wait=True)
    said, seen = [], []
    source.emit = lambda note: said.append((note.time_ns, note.text))
    for step, key in enumerate(["", "right", "n", "left", "p", "left", "r", "right"]):
        if key:
            source.keys[key]()
        source.read(step)
        seen.append((source.index, source.words))
    assert [index for index, _ in seen] == [0, 1, 2, 1, 0, 0, 0, 1]
    assert [words for _, words in seen] == ["abcd"[index] for index, _ in seen]
    assert source.title == "a page, line 2 of 4: b"
    # If a key repeats a line, a note announces the line again.
    assert said == [(5, "a page, line 1 of 4: a"), (6, "a page, line 1 of 4: a")]
    assert source.account == "3 lines read: a / b / c"
    assert source.sheet.number == 1


def test_a_pause_stands_still_and_a_line_again_begins_at_its_start(source_of, make_line):
    source = source_of(make_line())
    source.line(1, wait=True)
    source.read(0)
    before = source.read(1500 * MS).pose.x_mm
    assert before > -8
    source.keys[" "]()
    assert source.read(5000 * MS).pose.x_mm == before
    source.keys[" "]()
    assert source.read(5100 * MS).pose.x_mm == pytest.approx(before + 2.5)
    source.keys["r"]()
    assert source.read(5120 * MS).pose.x_mm == -8


def test_a_key_can_be_waited_for(source_of, make_line):
    source = source_of(make_line(10.0), make_line(10.0), motion=LineMotion(50.0), pause_s=math.inf)
    source.line(2, wait=True)
    for step in range(100):
        source.read(step * 100 * MS)
    assert source.index == 0
    source.keys["right"]()
    source.read(10_000 * MS)
    assert source.index == 1
    # After the last line, the source ends without waiting for a key.
    assert source.read(30_000 * MS) is not None
    assert source.read(30_020 * MS) is None


def test_a_line_that_is_late_is_waited_for_in_silence_and_named(source_of, make_line):
    recognized = threading.Event()

    def lines():
        yield make_line(text="one")
        recognized.wait(60)
        yield make_line(text="two")

    source = source_of(lines())
    assert source.line(0, wait=True).text == "one"
    source.read(0)
    source.keys["right"]()
    frame = source.read(20 * MS)
    assert (frame.force_n, source.total, source.account) == (0.0, None, "1 line read: one")
    recognized.set()
    source.line(2, wait=True)
    source.read(40 * MS)
    assert (source.account, source.total) == ("2 lines read: one / two", 2)


def test_an_error_comes_after_the_lines_before_it(source_of, make_line):
    torn = ReadingError("page 2 is torn")

    def broken():
        yield make_line()
        raise torn

    source = source_of(broken())
    assert source.line(0, wait=True) is not None
    assert source.read(0) is not None
    source.keys["right"]()
    for _ in range(2):
        with pytest.raises(ReadingError) as caught:
            source.line(1, wait=True)
        assert caught.value is torn


def test_of_a_book_only_what_lies_near_is_prepared_and_kept(source_of, make_line):
    line, made = make_line(), []

    def book():
        for number in range(1000):
            made.append(number)
            yield line

    source = source_of(book())
    for step in range(200):
        source.keys["right"]()
        source.line(step + 1, wait=True)
        source.read(step)
        assert len(made) <= step + AHEAD + 4
    assert source.index == 200
    for step in range(200):
        source.keys["left"]()
        source.read(1000 + step)
    assert source.index == 201 - BEHIND


def test_closed_it_prepares_no_more_and_lets_go_of_where_lines_come_from(source_of, make_line):
    let_go, go_on = threading.Event(), threading.Event()

    def endless():
        try:
            while True:
                yield make_line()
                go_on.wait(60)
        finally:
            let_go.set()

    source = source_of(endless())
    source.line(0, wait=True)
    source.close()
    go_on.set()
    assert let_go.wait(10)


def test_notes_are_told_when_they_arise(source_of, make_line):
    source, told = source_of(make_line()), []
    source.emit = told.append
    source.read(0)
    source.notes.append("page 1 is doubtful")
    source.read(7)
    source.read(8)
    assert [(note.time_ns, note.text) for note in told] == [(7, "page 1 is doubtful")]


@pytest.mark.parametrize("value", [-1.0, math.nan, 1e9])
def test_impossible_speeds_and_pauses_are_named(value, source_of, make_line):
    with raises(ReadingError, names="speed_mm_s", value=value):
        LineMotion(value)
    with raises(ReadingError, names="pause_s", value=value):
        source_of(make_line(), pause_s=value)
