"""Tests of live capture and cameras: newest image, counts of images, and reports of faults."""

import itertools
import math
import os
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.sources import camera, live_capture, open_source
from smarttouch.sources.camera import COMPRESSED, CameraDevice
from smarttouch.sources.flat_field_and_motion import FlatField
from smarttouch.sources.live_capture import ImageDevice, LiveSource, Shot

from ..support.checks import numbers_in, raises
from ..support.runs import until

SECOND = 1_000_000_000
ODD = ZeroDivisionError("by zero")


class Script(ImageDevice):
    """Device that plays ``events``: it returns shots, raises exceptions and calls functions."""

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
    """Return a function that cuts a 64 x 64 patch from a page; ``left`` is its first column."""
    random = np.random.default_rng(5).integers(0, 2, (64, 256)).astype(np.float32)
    page = cv2.GaussianBlur(255 * random, (0, 0), 2.5)
    return lambda left: np.clip(4 * (page[:, left : left + 64] - 96), 0, 255).astype(np.uint8)


def shot(value=0, taken_ns=0, missed=0):
    return Shot(np.full((8, 8), value, np.uint8), taken_ns, missed)


def test_the_newest_wins_and_may_be_read_again(profile):
    source = Script(shot(0))
    with LiveSource(source, profile) as sensor:
        assert sensor.read(0).number == 0
        for value in (1, 2, 3):
            source.events.append(shot(value))
        until(lambda: sensor.frames == 4)
        first, again = sensor.read(7), sensor.read(8)
        assert (first.number, again.number) == (3, 3)
        assert (first.time_ns, again.time_ns) == (7, 8)
        assert first.image[0, 0] == 3
        assert math.isnan(first.force_n)
        assert not sensor.knows_force
        assert sensor.dropped_frames == 2
        source.events.append(shot(4, missed=7))
        until(lambda: sensor.frames == 12)
        assert sensor.dropped_frames == 9
        assert sensor.read(9).number == 11
        source.events.append(shot(5))
        until(lambda: sensor.frames == 13)
    assert sensor.dropped_frames == 10
    assert sensor.read(0) is None


def test_age_and_staleness(profile):
    now = [10 * SECOND]
    with LiveSource(Script(shot(taken_ns=9_995_000_000)), profile, now_ns=lambda: now[0]) as sensor:
        for later_ns, age_ns in ((0, 5_000_000), (SECOND // 2, 505_000_000)):
            now[0] += later_ns
            frame = sensor.read(0)
            assert (frame.age_ns, frame.stale) == (age_ns, later_ns > 0)


def test_no_image_at_first(profile, monkeypatch):
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 0.01)
    mute = {"value": "camera 0", "allowed": 0.01}
    with LiveSource(Script(), profile) as sensor, raises(SourceError, **mute):
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
    """A device counts as returned when it gives an image, not when it can be opened."""
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
    source = Script(shot())
    with LiveSource(source, profile) as sensor:
        sensor.read(0)
        source.events.append(SourceLostError("gone"))
        until(lambda: sensor.notes)
    (note,) = sensor.notes
    assert numbers_in(note) == [0, 0.0]


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
    source = Script(Shot(page_patch(0), 0))
    with LiveSource(source, profile) as sensor:
        assert sensor.read(0).pose.x_mm == 0
        for step in range(1, 11):
            source.events.append(Shot(page_patch(4 * step), 0))
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


without_a_camera = pytest.mark.skipif(
    Path("/dev/video0").exists() or sys.platform == "darwin",
    reason="this machine may have a camera, which a test must not switch on",
)


class FakeCapture:
    """Fake `cv2.VideoCapture` of a 640 x 480 camera at 30 Hz; its state is in class attributes."""

    plugged, can_expose, taken_ms = True, True, 0.0

    def __init__(self, place, backend):
        self.opened.append((place, backend))
        self._open, self._exposure = self.plugged, 156.0

    def isOpened(self):  # noqa: N802 (OpenCV calls it that)
        return self._open

    def set(self, key, value):
        self.properties[key] = value
        if key == cv2.CAP_PROP_EXPOSURE and self.can_expose:
            self._exposure = min(max(value, 1), 5000)
        return key != cv2.CAP_PROP_EXPOSURE or self.can_expose

    def get(self, key):
        return {
            cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
            cv2.CAP_PROP_FPS: 30.0, cv2.CAP_PROP_EXPOSURE: self._exposure,
            cv2.CAP_PROP_POS_MSEC: self.taken_ms,
        }.get(key, -1.0)  # fmt: skip

    def read(self):
        self._open = self._open and self.plugged
        time.sleep(0.001)
        green = np.full((480, 640, 3), (0, 255, 0), np.uint8)
        return (True, green) if self._open else (False, None)

    def release(self):
        self._open = False


@pytest.fixture
def device(monkeypatch):
    device = type("Camera", (FakeCapture,), {"opened": [], "properties": {}})
    monkeypatch.setattr(cv2, "VideoCapture", device)
    monkeypatch.setattr(camera, "_PAUSE_S", 0.0)
    return device


def test_frames_are_grey_and_the_books_exact(profile, device):
    with open_source("camera:0", profile) as sensor:
        assert sensor.title == "camera 0"
        numbers = {sensor.read(0).number for _ in range(100)}
        until(lambda: sensor.frames > 5)
        frame = sensor.read(0)
        numbers.add(frame.number)
    assert frame.image.shape == (480, 640)
    assert (frame.image == 150).all()
    assert sensor.frames == len(numbers) + sensor.dropped_frames
    assert sensor.notes == []
    assert device.properties[cv2.CAP_PROP_BUFFERSIZE] == 1
    assert device.properties[cv2.CAP_PROP_FOURCC] == COMPRESSED


@pytest.mark.parametrize(("rest", "place"), [("3", 3), ("/dev/video2", "/dev/video2")])
def test_by_number_or_device_and_never_as_a_file(profile, device, monkeypatch, rest, place):
    monkeypatch.setattr("sys.platform", "linux")
    open_source(f"camera:{rest}", profile).close()
    assert device.opened == [(place, cv2.CAP_V4L2)]


def test_what_the_camera_does_not_accept_is_noted_once(profile, device):
    source = CameraDevice("0", (800, 600), 9000.0, 120.0)
    source.open()
    source.open()
    assert [numbers_in(note) for note in source.notes] == [
        [0, 640, 480, 800, 600],
        [0, 30, 120],
        [0, 5000, 9000],
    ]
    device.can_expose = False
    source = CameraDevice("0", exposure=50.0)
    source.open()
    assert [numbers_in(note) for note in source.notes] == [[0, 50]]


@pytest.mark.parametrize(("rest", "options", "value"), [
    *((rest, {}, rest) for rest in ("", "-1", "1e3", "99999", "http://x/y")),
    *(("0", {"size": size}, size) for size in ((0, 480), (10**6, 10**6))),
    *(("0", {"fps": fps}, fps) for fps in (math.nan, -5.0)),
    ("0", {"exposure": math.nan}, math.nan),
    # Options of other sensors are refused.
    ("0", {"baud": 9600}, ("size", "exposure", "fps")),
])  # fmt: skip
def test_what_cannot_be(profile, device, rest, options, value):
    with raises(SourceError, value=value):
        open_source(f"camera:{rest}", profile, **options)
    assert device.opened == []


def test_gone_is_several_failures_in_a_row(device):
    source = CameraDevice("0")
    source.open()
    device.plugged = False
    assert [source.grab(0.0) for _ in range(camera.FAILURES - 1)] == [None] * 4
    with raises(SourceLostError, names="camera", value=0):
        source.grab(0.0)
    source.close()
    source.close()
    with raises(SourceLostError, names="camera", value=0):
        source.grab(0.0)


def test_the_driver_may_report_when_an_image_was_taken(device, monkeypatch):
    now_ns = 7_000_000_000_000
    monkeypatch.setattr(camera.time, "perf_counter_ns", lambda: now_ns)
    source = CameraDevice("0")
    source.open()
    for age_ms in (0, 30, 1999):
        device.taken_ms = now_ns / 1e6 - age_ms
        assert source.grab(0.0).taken_ns == now_ns - age_ms * 1_000_000
    for elsewhen_ms in (0.0, -1.0, now_ns / 1e6 + 1, now_ns / 1e6 - 2001):
        device.taken_ms = elsewhen_ms
        assert source.grab(0.0).taken_ns == now_ns


@pytest.mark.parametrize("place", [
    pytest.param("camera:0", marks=without_a_camera),
    "camera:971",
    "camera:/dev/null",
    "camera:/dev/video971",
])  # fmt: skip
def test_a_missing_camera_is_one_sentence_and_nothing_else(profile, capfd, place):
    """This test uses the real OpenCV."""
    with raises(SourceError, names="camera", value=place.removeprefix("camera:")):
        open_source(place, profile)
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_a_camera_without_permission_names_the_remedy(profile, device, monkeypatch, tmp_path):
    node = tmp_path / "video0"
    node.touch()
    device.plugged = False
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != str(node))
    with raises(SourceError, names=("usermod", "video"), value=node):
        open_source(f"camera:{node}", profile)


def test_nodes_for_metadata_are_not_listed(monkeypatch, tmp_path):
    for number, (index, name) in enumerate([(0, "Cam"), (1, "Cam"), (0, "IR"), (1, "IR")]):
        node = tmp_path / f"video{number}"
        node.mkdir()
        (node / "index").write_text(f"{index}\n")
        (node / "name").write_text(f"{name}\n")
    monkeypatch.setattr(camera, "Path", lambda _: tmp_path)
    assert camera.cameras() == [(0, "Cam"), (2, "IR")]
