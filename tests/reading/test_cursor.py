"""The finger moves line by line, as fast as asked, forward and back."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import ReadingError
from smarttouch.reading.line_feed import LineFeed, TouchLine
from smarttouch.reading.line_source import (
    GAP,
    LAND_S,
    SETTLE_S,
    LineMotion,
    SweepingCursor,
)

from ..raising import raises

MS = 1_000_000


def spots_of(cursor, step_ms=20, most=2000):
    """All spots until the end, with their times in seconds."""
    found = []
    for step in range(most):
        spot = cursor.at(step * step_ms * MS)
        if spot is None:
            return found
        found.append((step * step_ms / 1000, spot))
    raise AssertionError("it never ends")


def test_a_line_is_swept_from_before_its_start_to_after_its_end(feed_of, make_line):
    line = make_line(30.0)
    spots = spots_of(SweepingCursor(feed_of(line), LineMotion(25.0), 1.0))
    on_line = [(time_s, spot) for time_s, spot in spots if spot.line is not None]
    assert on_line[0][1].x_mm == line.start_mm
    assert on_line[-1][1].x_mm == pytest.approx(line.end_mm, abs=0.6)
    for time_s, spot in on_line:
        wanted = line.start_mm + max(0.0, time_s - SETTLE_S) * 25.0
        assert spot.x_mm == pytest.approx(wanted)
        assert spot.force_n == (1.0 if time_s >= LAND_S else 0.0)
        assert spot.marked == (time_s < SETTLE_S)


def test_between_lines_it_is_lifted_for_as_long_as_asked(feed_of, make_line):
    feed = feed_of(make_line(10.0), make_line(10.0))
    spots = spots_of(SweepingCursor(feed, LineMotion(50.0), 1.0, pause_s=0.5))
    lifted = [time_s for time_s, spot in spots if spot.force_n == 0 and spot.index == 0]
    assert max(lifted) - min(each for each in lifted if each > LAND_S) == pytest.approx(0.5, 0.1)
    assert {spot.index for _, spot in spots if spot.line is not None} == {0, 1}


def test_text_that_moves_in_steps_stands_still_between_them(feed_of, make_line):
    spots = spots_of(SweepingCursor(feed_of(make_line()), LineMotion(25.0, 2.0), 1.0))
    places = [spot.x_mm for _, spot in spots if spot.line is not None]
    assert all((x + 8.0) % 2.0 == 0 for x in places)
    assert {round(b - a, 9) for a, b in itertools.pairwise(places)} == {0.0, 2.0}


def test_each_of_several_steps_begins_with_a_silence(feed_of, make_line):
    spots = spots_of(SweepingCursor(feed_of(make_line()), LineMotion(10.0, 4.0, True), 1.0), 10)
    reading = [(time_s, spot) for time_s, spot in spots if time_s > SETTLE_S and spot.force_n]
    shown = [spot.line is not None for _, spot in reading]
    assert sum(shown) / len(shown) == pytest.approx(1 - GAP, abs=0.03)
    # What is shown first is shown as long as all that follows.
    assert not any(spot.line for time_s, spot in spots if time_s < SETTLE_S)


def test_keys_go_forward_back_and_again(feed_of, make_line):
    cursor = SweepingCursor(feed_of(*[make_line() for _ in range(4)]), LineMotion(25.0), 1.0)
    seen = []
    for step, key in enumerate(["", "right", "n", "left", "p", "left", "r", "right"]):
        if key:
            cursor.keys[key]()
        seen.append(cursor.at(step * 20 * MS).index)
    assert seen == [0, 1, 2, 1, 0, 0, 0, 1]


def test_in_a_long_text_only_what_is_near_can_be_gone_back_to(make_line):
    line = make_line()
    feed = LineFeed(iter([line] * 500)).start()
    cursor = SweepingCursor(feed, LineMotion(25.0), 1.0)
    for step in range(200):
        cursor.keys["right"]()
        feed.wait_for(step + 1, 10)
        assert cursor.at(2 * step * MS).index == step + 1
    for step in range(200):
        cursor.keys["left"]()
        index = cursor.at((1000 + 2 * step) * MS).index
    assert 100 < index == feed.earliest
    feed.close()


def test_the_line_again_begins_at_its_start(feed_of, make_line):
    cursor = SweepingCursor(feed_of(make_line()), LineMotion(25.0), 1.0)
    cursor.at(0)
    assert cursor.at(1500 * MS).x_mm > -8
    cursor.keys["r"]()
    assert cursor.at(1520 * MS).x_mm == -8


def test_a_pause_stands_still(feed_of, make_line):
    cursor = SweepingCursor(feed_of(make_line()), LineMotion(25.0), 1.0)
    cursor.at(0)
    before = cursor.at(1500 * MS).x_mm
    cursor.keys[" "]()
    assert cursor.at(5000 * MS).x_mm == before
    cursor.keys[" "]()
    assert cursor.at(5100 * MS).x_mm == pytest.approx(before + 2.5)


def test_a_key_can_be_waited_for(feed_of, make_line):
    feed = feed_of(make_line(10.0), make_line(10.0))
    cursor = SweepingCursor(feed, LineMotion(50.0), 1.0, math.inf)
    assert [cursor.at(step * 100 * MS).index for step in range(100)] == [0] * 100
    cursor.keys["right"]()
    assert cursor.at(10_000 * MS).index == 1
    # After the last there is nothing to wait for.
    assert cursor.at(30_000 * MS) is not None
    assert cursor.at(30_020 * MS) is None


def test_a_line_that_is_not_ready_is_waited_for_in_silence(make_line):
    feed = LineFeed(iter([make_line()]))
    cursor = SweepingCursor(feed, LineMotion(25.0), 1.0)
    spot = cursor.at(0)
    assert (spot.line, spot.force_n) == (None, 0.0)
    feed.start().wait_for_end(10)
    assert cursor.at(20 * MS).line is not None


@given(speed=st.floats(1, 500), keys=st.lists(st.sampled_from(["right", "left", "r", " ", ""])))
def test_whatever_is_pressed_it_stays_on_the_text(speed, keys):
    lines = [TouchLine(np.full((8, 40), 255, np.uint8), -4.0, 24.0) for _ in range(3)]
    feed = LineFeed(iter(lines)).start()
    feed.wait_for_end(10)
    cursor = SweepingCursor(feed, LineMotion(speed), 1.0)
    for step, key in enumerate(keys):
        cursor.keys.get(key, lambda: None)()
        spot = cursor.at(step * 50 * MS)
        if spot is None:
            break
        assert 0 <= spot.index < 3
        assert spot.line is None or -4.0 <= spot.x_mm <= 24.0


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf, 1e6])
def test_impossible_speeds_are_named(speed):
    with raises(ReadingError, names="speed_mm_s", value=speed):
        LineMotion(speed)


@pytest.mark.parametrize("pause", [-1.0, math.nan, 1e9])
def test_impossible_pauses_are_named(pause, feed_of, make_line):
    with raises(ReadingError, names="pause_s", value=pause):
        SweepingCursor(feed_of(make_line()), LineMotion(25.0), 1.0, pause)
