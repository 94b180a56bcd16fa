"""Newest wins, every image is read or counted as dropped, and no fault goes unreported."""

import itertools
import math
import threading
import time
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.sources import live_capture
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot
from smarttouch.sources.preprocess import FlatField

from ..support.checks import numbers_in, raises
from ..support.runs import until

SECOND = 1_000_000_000
ODD = ZeroDivisionError("by zero")


class Script(ImageDevice):
    """Does as it is set: shots are given, exceptions raised; at the end, nothing comes."""

    title = "camera 0"

    def __init__(self, *events, opens=()):
        self.events = list(events)
        self.opens = list(opens)
        self.is_open = False
        self.closes = 0

    def open(self):
        if self.opens and isinstance(error := self.opens.pop(0), Exception):
            raise error
        self.is_open = True

    def grab(self, timeout_s):
        assert self.is_open
        if not self.events:
            time.sleep(0.001)
            return None
        event = self.events.pop(0)
        if isinstance(event, Exception):
            raise event
        return event() if callable(event) else event

    def close(self):
        self.is_open = False
        self.closes += 1


class Handed(ImageDevice):
    """Gives what a test hands over, one image after the other."""

    title = "by hand"

    def __init__(self, *events):
        self.condition = threading.Condition()
        self.waiting = list(events)

    def open(self):
        pass

    def close(self):
        pass

    def grab(self, timeout_s):
        with self.condition:
            self.condition.wait_for(lambda: self.waiting, timeout_s)
            event = self.waiting.pop(0) if self.waiting else None
        if isinstance(event, Exception):
            raise event
        return event

    def hand(self, event):
        with self.condition:
            self.waiting.append(event)
            self.condition.notify()


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(live_capture, "RETRY_S", 0.001)


@pytest.fixture(autouse=True)
def no_thread_left():
    before = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) == before


@pytest.fixture(scope="module")
def page_patch():
    """Return a maker of 64 x 64 patches of one page, so many pixels from its left edge."""
    random = np.random.default_rng(5).integers(0, 2, (64, 256)).astype(np.float32)
    page = cv2.GaussianBlur(255 * random, (0, 0), 2.5)
    return lambda left: np.clip(4 * (page[:, left : left + 64] - 96), 0, 255).astype(np.uint8)


def shot(value=0, taken_ns=0, missed=0):
    return Shot(np.full((8, 8), value, np.uint8), taken_ns, missed)


@given(
    st.lists(st.tuples(st.integers(0, 3), st.booleans()), max_size=60),
    st.lists(st.integers(0, 3), max_size=30),
)
def test_the_books_are_exact(profile, images, pauses):
    """Whatever the rates of source and reader, and wherever the reader stops."""
    naps = itertools.cycle([0.0, 0.0005, 0.0])

    def slow(each):
        time.sleep(next(naps))
        return each

    events = [
        partial(slow, shot(missed=missed)) if sleeps else shot(missed=missed)
        for missed, sleeps in images
    ]
    sensor = LiveSource(Script(*events), profile)
    read = set()
    with sensor:
        for pause in pauses:
            time.sleep(pause * 0.0003)
            if images:
                read.add(sensor.read(0).number)
    assert sensor.frames == len(read) + sensor.dropped_frames
    assert sensor.frames <= sum(missed + 1 for missed, _ in images)
    assert sensor.read(0) is None


def test_the_newest_wins_and_may_be_read_again(profile):
    source = Handed(shot(0))
    with LiveSource(source, profile) as sensor:
        assert sensor.read(0).number == 0
        for value in (1, 2, 3):
            source.hand(shot(value))
        until(lambda: sensor.frames == 4)
        first, again = sensor.read(7), sensor.read(8)
        assert (first.number, again.number) == (3, 3)
        assert (first.time_ns, again.time_ns) == (7, 8)
        assert first.image[0, 0] == 3
        assert math.isnan(first.force_n)
        assert not sensor.knows_force
        assert sensor.dropped_frames == 2
        source.hand(shot(4))
        until(lambda: sensor.frames == 5)
    assert sensor.dropped_frames == 3


def test_age_and_staleness(profile):
    now = [10 * SECOND]
    source = Handed(shot(taken_ns=10 * SECOND - 5_000_000))
    with LiveSource(source, profile, now_ns=lambda: now[0]) as sensor:
        frame = sensor.read(0)
        assert (frame.age_ns, frame.stale) == (5_000_000, False)
        now[0] += SECOND // 2
        frame = sensor.read(0)
        assert (frame.age_ns, frame.stale) == (505_000_000, True)


def test_no_image_at_first(profile, monkeypatch):
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 0.01)
    mute = {"value": "by hand", "allowed": 0.01}
    with LiveSource(Handed(), profile) as sensor, raises(SourceError, **mute):
        sensor.read(0)


@pytest.mark.parametrize(("error", "attributes"), [
    (SourceError("of its own"), {"__cause__": None}),
    (ODD, {"value": "camera 0", "__cause__": ODD}),
])  # fmt: skip
def test_errors_of_the_thread_reach_the_reader(profile, error, attributes):
    source = Script(error)
    with LiveSource(source, profile) as sensor:
        for _ in range(2):
            with raises(SourceError, **attributes) as caught:
                sensor.read(0)
            assert str(error) in str(caught.value)
    assert source.closes == 1
    assert sensor.notes == []


def test_unplugged_and_plugged_in_again(profile):
    """Back is a source that gives an image, not one that can be opened."""
    now = [0]

    def later():
        now[0] += 1_150_000_000
        raise SourceLostError("gone again")

    lost = SourceLostError("gone")
    opens = [None, SourceError("not yet"), None]
    source = Script(shot(0), lost, later, None, later, shot(1), opens=opens)
    with LiveSource(source, profile, now_ns=lambda: now[0]) as sensor:
        numbers = {sensor.read(0).number}
        until(lambda: sensor.read(0).number == 1)
    (note,) = sensor.notes
    assert numbers_in(note) == [0, 2.3]
    assert sensor.frames == len(numbers | {1}) + sensor.dropped_frames == 2


def test_not_plugged_in_again(profile):
    now = itertools.count(0, SECOND)
    gone = [SourceError("no camera")] * 20
    source = Script(shot(0), SourceLostError("gone"), opens=[None, *gone])
    sensor = LiveSource(source, profile, replug_s=3, now_ns=lambda: next(now))
    lost = {"value": "camera 0", "allowed": 3}
    with sensor, raises(SourceError, **lost):
        until(lambda: sensor.read(0) is None)
    assert sensor.frames == 1


def test_closing_while_it_is_gone(profile, monkeypatch):
    monkeypatch.setattr(live_capture, "RETRY_S", 60.0)
    source = Handed(shot())
    with LiveSource(source, profile) as sensor:
        sensor.read(0)
        source.hand(SourceLostError("gone"))
        until(lambda: sensor.notes)
    (note,) = sensor.notes
    assert numbers_in(note) == [0.0]


def test_a_driver_that_hangs_is_left_behind(profile, monkeypatch):
    monkeypatch.setattr(live_capture, "JOIN_S", 0.01)
    free = threading.Event()

    def hang():
        free.wait(30)
        return shot(9)

    source = Script(shot(), hang)
    sensor = LiveSource(source, profile)
    sensor.read(0)
    until(lambda: not source.events)
    sensor.close()
    sensor.close()
    (note,) = sensor.notes
    assert numbers_in(note) == [0, 0.01]
    free.set()
    sensor._thread.join()
    assert source.closes == 1
    assert (sensor.frames, sensor.dropped_frames) == (1, 0)


def test_motion_is_summed_over_images_that_nobody_reads(profile, page_patch):
    source = Handed(Shot(page_patch(0), 0))
    with LiveSource(source, profile) as sensor:
        assert sensor.read(0).pose.x_mm == 0
        for step in range(1, 11):
            source.hand(Shot(page_patch(4 * step), 0))
        until(lambda: sensor.frames == 11)
        pixel_mm = profile.optics.field_width_mm / 64
        assert sensor.read(0).pose.x_mm == pytest.approx(40 * pixel_mm, abs=0.2 * pixel_mm)
    assert sensor.dropped_frames == 9


def test_the_flat_field_of_the_profile_is_applied(profile, changed, tmp_path):
    path = tmp_path / "flat.npz"
    dark = np.full((8, 8), 10, np.float32)
    path.write_bytes(FlatField(dark, np.full((8, 8), 2, np.float32)).to_bytes())
    corrected = changed(profile, {"optics.flat_field": str(path)})
    with LiveSource(Script(shot(60)), corrected) as sensor:
        assert (sensor.read(0).image == 100).all()
    other = Shot(np.zeros((9, 9), np.uint8), 0)
    misfit = {"names": "optics.flat_field", "value": (9, 9)}
    with LiveSource(Script(other), corrected) as sensor, raises(SourceError, **misfit):
        sensor.read(0)
