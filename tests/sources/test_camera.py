"""Cameras: refused settings are noted, losses are detected, and OpenCV stays silent.

There is no camera where tests run: `FakeCapture` is one that can be unplugged.
"""

import math
import os
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.sources import camera, live_capture, open_source
from smarttouch.sources.camera import COMPRESSED, CameraDevice

from ..support.checks import numbers_in, raises
from ..support.runs import until

without_a_camera = pytest.mark.skipif(
    Path("/dev/video0").exists() or sys.platform == "darwin",
    reason="a test must not switch on a camera that is there",
)


class Device:
    """Camera on its end of the cable."""

    def __init__(self):
        self.plugged = True
        self.sizes = [(640, 480), (320, 240)]
        self.exposures = (1, 5000)
        self.taken_ms = 0.0
        self.pictures = 0
        self.opened = []
        self.properties = {}


class FakeCapture:
    """`cv2.VideoCapture` in front of a device."""

    device: Device

    def __init__(self, place, backend):
        self.device.opened.append((place, backend))
        self._open = self.device.plugged
        self._values = {
            cv2.CAP_PROP_FRAME_WIDTH: 640.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
            cv2.CAP_PROP_FPS: 30.0,
            cv2.CAP_PROP_EXPOSURE: 156.0,
        }

    def isOpened(self):  # noqa: N802 (OpenCV calls it that)
        return self._open

    def set(self, key, value):
        device = self.device
        device.properties[key] = value
        if key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            axis = int(key == cv2.CAP_PROP_FRAME_HEIGHT)
            value = min((size[axis] for size in device.sizes), key=lambda side: abs(side - value))
        if key == cv2.CAP_PROP_FPS:
            value = 30.0
        if key == cv2.CAP_PROP_EXPOSURE:
            if device.exposures is None:
                return False
            value = min(max(value, device.exposures[0]), device.exposures[1])
        self._values[key] = float(value)
        return True

    def get(self, key):
        return self.device.taken_ms if key == cv2.CAP_PROP_POS_MSEC else self._values.get(key, -1.0)

    def read(self):
        if not (self._open and self.device.plugged):
            self._open = False
            return False, None
        time.sleep(0.001)
        self.device.pictures += 1
        return True, np.full((480, 640, 3), (0, 255, 0), np.uint8)

    def release(self):
        self._open = False


@pytest.fixture
def device(monkeypatch):
    device = Device()
    monkeypatch.setattr(FakeCapture, "device", device, raising=False)
    monkeypatch.setattr(cv2, "VideoCapture", FakeCapture)
    monkeypatch.setattr(live_capture, "RETRY_S", 0.001)
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
    device.exposures = None
    source = CameraDevice("0", exposure=50.0)
    source.open()
    assert [numbers_in(note) for note in source.notes] == [[0, 50]]


@pytest.mark.parametrize(("rest", "options", "about", "value"), [
    *((rest, {}, "camera", rest) for rest in ("", "-1", "1e3", "99999", "http://x/y")),
    *(("0", {"size": size}, "size", size) for size in ((0, 480), (10**6, 10**6))),
    *(("0", {"fps": fps}, "fps", fps) for fps in (math.nan, -5.0)),
    ("0", {"exposure": math.nan}, "exposure", math.nan),
    # An option of other sensors is not taken.
    ("0", {"baud": 9600}, "baud", ("size", "exposure", "fps")),
])  # fmt: skip
def test_what_cannot_be(profile, device, rest, options, about, value):
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
    """The real OpenCV."""
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
