"""Motions of a hand: virtual strokes, a recorded path, the pose of a sensor, a mouse."""

import os
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.instruments.hand_motion import (
    REST_S,
    START_S,
    SweepMotion,
    open_motion,
    strokes_over,
)

from ..support.checks import raises
from ..support.runs import until


def places(motion, step_s=0.01):
    found, time_s = [], 0.0
    while (place := motion.read(round(1e9 * time_s))) is not None:
        found.append(place)
        time_s += step_s
    return np.array(found)


def test_a_virtual_hand_strokes_back_and_forth():
    way = places(SweepMotion(50.0, (40.0, 0.0)))
    speed = np.hypot(*np.diff(way, axis=0).T) / 0.01
    moving = speed > 1
    assert np.median(speed[moving]) == pytest.approx(50.0)
    assert way[:, 0].max() == pytest.approx(40.0)
    assert way[-1] == pytest.approx([0, 0], abs=1e-6)
    assert not moving[: round(START_S * 100) - 1].any()
    assert len(way) == pytest.approx(100 * (START_S + 1.6 + 2 * REST_S), abs=2)


@given(st.floats(1, 200), st.floats(1, 100), st.floats(2, 30), st.floats(2, 30))
def test_strokes_pass_every_electrode_over_all_of_a_texture(wide, high, across, down):
    options = strokes_over((wide, high), (across, down))
    (left, top), motion = options.pop("origin_mm"), SweepMotion(1000.0, **options)
    x, y = (motion._table[:, 1:] + (left, top)).T
    assert (x.min() + across / 2, x.max() - across / 2) == pytest.approx((0, wide))
    lanes = np.unique(np.round(y, 6))
    # The lanes cover the texture, except for 15 % of a lane's height at each edge.
    left_over = 0.15 * down + 1e-6
    assert lanes[0] - down / 2 <= left_over
    assert lanes[-1] + down / 2 >= high - left_over
    assert (np.diff(lanes) <= down + left_over).all()
    assert high > down or lanes == pytest.approx([high / 2])


def test_a_recorded_way(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("force_n, time_s,x_mm,note,y_mm\n0.2,5,10,a,3\n0.6,6,14,b,1\n\n0,8,14,,1\n")
    motion = open_motion(f"path:{path}")
    assert motion.read(500_000_000) == pytest.approx((2, -1))
    assert motion.force_n == pytest.approx(0.4)
    assert motion.origin_mm == (10, 3)
    assert motion.read(3_000_000_001) is None
    assert (motion.knows_force, motion.duration_s) == (True, 3)
    path.write_text("x_mm,y_mm\n0,0\n")
    with raises(SourceError, names="way.csv", value=("x_mm", "y_mm")):
        open_motion(f"path:{path}")


def test_a_sensor_gives_the_motion():
    with open_motion("text:abc") as motion:
        assert motion.read(0) == (0, 0)
        assert motion.read(900_000_000)[0] > 0
        assert motion.knows_force
        assert motion.force_n > 0


@pytest.mark.parametrize(("url", "options", "about", "value"), [
    ("wheel:", {}, "motion", "wheel:"),
    ("sweep:x", {}, "rounds", "x"),
    ("sweep:0", {}, "rounds", "0"),
    ("sweep:99999", {}, "rounds", "99999"),
    ("sweep:", {"speed_mm_s": 0.0}, "speed_mm_s", 0.0),
    ("sweep:", {"cpi": 400}, "cpi", "sweep:"),
    ("path:", {}, "file", None),
    ("path:none.csv", {}, "file", Path("none.csv")),
    ("camera:x", {}, "camera", "x"),
])  # fmt: skip
def test_errors_are_reported(url, options, about, value):
    known = ("sweep", "path", "evdev", "camera")
    allowed = {"motion": known, "rounds": (1, 10_000)}.get(about)
    with raises(SourceError, names=about, value=value, allowed=allowed):
        open_motion(url, **options)


CODES = SimpleNamespace(EV_SYN=0, EV_REL=2, REL_X=0, REL_Y=1, REL_WHEEL=8, SYN_DROPPED=3)


class FakeDevice:
    """Fake device of evdev; a byte in a pipe tells the reader that events are available."""

    moves = (0, 1, 8)
    error = None
    taken = False

    def __init__(self, path, readonly=False):
        if self.error is not None:
            raise self.error
        assert readonly
        self.path, self.name = path, "a fake mouse"
        self.fd, self._wake = os.pipe()
        self._events, self.closed = [], False
        type(self).latest = self

    def capabilities(self):
        return {CODES.EV_REL: list(self.moves)}

    def play(self, *events):
        self._events += [SimpleNamespace(type=a, code=b, value=c) for a, b, c in events]
        os.write(self._wake, b"x")

    def read(self):
        if not os.read(self.fd, 1):
            raise OSError(19, "No such device")
        events, self._events = self._events, []
        return events

    def pull_out(self):
        os.close(self._wake)

    def close(self):
        if not self.closed:
            os.close(self.fd)
            self.closed = True


@pytest.fixture
def device(monkeypatch, tmp_path):
    """Install a fake evdev module with one device; return the class of this device."""
    kind = type("Device", (FakeDevice,), {})
    path = tmp_path / "event7"
    path.touch()
    module = ModuleType("evdev")
    module.InputDevice, module.ecodes = kind, CODES
    module.list_devices = lambda: [str(path)]
    monkeypatch.setitem(sys.modules, "evdev", module)
    kind.place = str(path)
    return kind


def test_counts_become_millimeters_until_the_mouse_is_pulled_out(device):
    with open_motion("evdev:", cpi=508) as motion:
        assert motion.read(0) == (0, 0)
        device.latest.play((2, 0, 10), (2, 1, -4), (0, 0, 0), (2, 8, 50), (1, 272, 1), (2, 0, 10))
        until(lambda: motion.read(0) == pytest.approx((1.0, -0.2)))
        assert motion.resolution_mm == pytest.approx(0.05)
        assert not motion.knows_force
        assert motion.notes == []
        device.latest.play((0, 3, 0), (0, 3, 0), (2, 1, 404))
        until(lambda: motion.read(0) == pytest.approx((1.0, 20.0)))
        assert len(motion.notes) == 1, "expected one note for two losses of events"
        device.latest.pull_out()
        with raises(SourceLostError, value=device.place):
            until(lambda: motion.read(0) is None)
    assert device.latest.closed


def test_the_first_mouse_is_found_among_others(device, monkeypatch):
    class Several(device):
        def __init__(self, path, readonly=False):
            super().__init__(path, readonly)
            self.moves = (8,) if path == "event2" else (0, 1)

    monkeypatch.setattr(sys.modules["evdev"], "InputDevice", Several)
    monkeypatch.setattr(
        sys.modules["evdev"], "list_devices", lambda: ["event10", "event2", "event3"]
    )
    open_motion("evdev:").close()
    assert Several.latest.path == "event3"


@pytest.mark.parametrize("error", [PermissionError(13, "no"), OSError(25, "Inappropriate")])
def test_a_device_that_cannot_be_read(device, error):
    device.error = error
    with raises(SourceError, value=device.place):
        open_motion(f"evdev:{device.place}")


def test_what_is_no_mouse(device, monkeypatch):
    device.moves = (8,)
    with raises(SourceError, value=device.place):
        open_motion(f"evdev:{device.place}")
    assert device.latest.closed
    monkeypatch.setattr(sys.modules["evdev"], "list_devices", list)
    with raises(SourceError, value="/dev/input") as caught:
        open_motion("evdev:")
    assert "usermod" in str(caught.value), "no advice on how to get access"
    with raises(SourceError, value="/dev/input/none"):
        open_motion("evdev:/dev/input/none")
    with raises(SourceError, value=1, allowed=(10, 100_000)):
        open_motion("evdev:", cpi=1)
