"""Frames are what lies under the array."""

import threading

import numpy as np
import pytest

from smarttouch.imaging.array_window import pixel_pitch_mm
from smarttouch.reading.line_feed import LineFeed
from smarttouch.reading.line_source import LineMotion, ReadingSource, Spot, SweepingCursor


class Stands:
    """A cursor at the place that the test sets."""

    def __init__(self, *spots):
        self.spots = list(spots)

    def at(self, time_ns):
        return self.spots.pop(0) if self.spots else None


def test_a_frame_is_a_window_on_the_line(reading, feed_of, make_line):
    line, pixel_mm = make_line(30.0, (10.0, 14.0)), pixel_pitch_mm(reading)
    spots = [Spot(0, line, x_mm, 1.0) for x_mm in (12.0, 4.0)]
    source = ReadingSource("x", reading, feed_of(line), Stands(*spots))
    frames = [source.read(each) for each in range(2)]
    assert source.read(2) is None
    columns = reading.optics.sensor_columns
    for frame, spot in zip(frames, spots, strict=True):
        center_mm = spot.x_mm + (np.arange(columns) + 0.5 - columns / 2) * pixel_mm
        ink = (center_mm > 10.0) & (center_mm < 14.0)
        np.testing.assert_array_equal(frame.image[8] == 0, ink)
        assert frame.pose.x_mm == spot.x_mm
    assert (frames[0].image[-1] == 0).any()


def test_without_a_line_there_is_paper(reading, feed_of, make_line):
    source = ReadingSource("x", reading, feed_of(make_line()), Stands(Spot(0, None)))
    frame = source.read(0)
    assert (frame.image == 255).all()
    assert frame.force_n == 0


def test_a_point_marks_the_start_of_a_line(reading, feed_of, make_line):
    """Without pulses before it, the first letters would be those that rise from nothing."""
    source = ReadingSource("x", reading, feed_of(make_line()), Stands(Spot(0, None, marked=True)))
    image = source.read(0).image
    dark = [(image == 0).any(axis=axis).sum() for axis in (0, 1)]
    cell_mm, pixel_mm = reading.electrodes.cell_mm, pixel_pitch_mm(reading)
    assert dark == pytest.approx([side / pixel_mm for side in cell_mm], abs=1)
    assert (image == 0).sum() == dark[0] * dark[1]


def test_notes_are_told_when_they_arise(reading, feed_of, make_line):
    spots = [Spot(0, None)] * 3
    source = ReadingSource("x", reading, feed_of(make_line()), Stands(*spots))
    told = []
    source.emit = told.append
    source.read(0)
    source.notes.append("page 1 is doubtful")
    source.read(7)
    source.read(8)
    assert [(note.time_ns, note.text) for note in told] == [(7, "page 1 is doubtful")]


def test_a_line_that_is_asked_for_again_is_announced_again(reading, feed_of, make_line):
    """Each line once by the title; after the key, once more by a note."""
    marks = [(0, True), (0, False), (1, False), (1, True), (1, False), (1, True), (1, False)]
    stands = Stands(*(Spot(index, None, marked=marked) for index, marked in marks))
    source, said = ReadingSource("a page", reading, feed_of(make_line(), make_line()), stands), []
    source.emit = said.append
    titles = [(source.read(number), source.title)[1] for number in range(len(marks))]
    assert [(each.time_ns, each.text) for each in said] == [(5, titles[5])]
    assert len({*titles}) == 2


def test_lines_lie_one_below_the_other(reading, feed_of, make_line):
    line = make_line(text="what it says")
    stands = Stands(*(Spot(index, line, 5.0, 1.0) for index in range(3)))
    source = ReadingSource("a page", reading, feed_of(line, line, line), stands)
    heights = [source.read(each).pose.y_mm for each in range(3)]
    assert np.diff(heights) == pytest.approx([source.line_step_mm] * 2)
    assert source.line_step_mm > reading.electrodes.extent_mm[1]
    assert source.title == "a page, line 3 of 3: what it says"


def test_a_line_that_was_late_is_named_all_the_same(reading, make_line):
    recognized = threading.Event()

    def lines():
        yield make_line(text="one")
        recognized.wait(10)
        yield make_line(text="two")

    feed = LineFeed(lines()).start()
    first = feed.wait_for(0)
    stands = Stands(Spot(0, first, 5.0, 1.0), Spot(1, None), Spot(1, None))
    source = ReadingSource("x", reading, feed, stands)
    source.read(0)
    source.read(1)
    assert source.account == "1 line read: one"
    recognized.set()
    assert feed.wait_for(1, 10) is not None
    source.read(2)
    feed.close()
    assert source.account == "2 lines read: one / two"
    assert source.title.endswith("two")


def test_it_heeds_the_keys_of_its_cursor(reading, feed_of, make_line):
    feed = feed_of(make_line(), make_line())
    source = ReadingSource("x", reading, feed, SweepingCursor(feed, LineMotion(25.0), 1.0))
    source.read(0)
    source.keys["right"]()
    source.read(20_000_000)
    assert source.index == 1
