"""A mouse of this machine, played by one that has its interface and no kernel behind it."""

import os
import sys
from types import ModuleType, SimpleNamespace

import pytest

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.instruments.hand_motion import open_motion

from ..raising import raises
from ..waiting import until

CODES = SimpleNamespace(EV_SYN=0, EV_REL=2, REL_X=0, REL_Y=1, REL_WHEEL=8, SYN_DROPPED=3)


class FakeDevice:
    """Events come through a pipe, one byte each to wake who waits."""

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
    """Return a kind of device of which there is one, and its path."""
    kind = type("Device", (FakeDevice,), {})
    path = tmp_path / "event7"
    path.touch()
    module = ModuleType("evdev")
    module.InputDevice, module.ecodes = kind, CODES
    module.list_devices = lambda: [str(path)]
    monkeypatch.setitem(sys.modules, "evdev", module)
    kind.place = str(path)
    return kind


def await_mm(motion, wanted):
    until(lambda: motion.read(0) == pytest.approx(wanted))


def test_counts_become_millimeters(device):
    with open_motion("evdev:", cpi=508) as motion:
        assert motion.read(0) == (0, 0)
        device.latest.play((2, 0, 10), (2, 1, -4), (0, 0, 0), (2, 8, 50), (1, 272, 1), (2, 0, 10))
        await_mm(motion, (1.0, -0.2))
        assert motion.resolution_mm == pytest.approx(0.05)
        assert not motion.knows_force
    assert device.latest.closed


def test_what_moved_before_the_first_look_does_not_count(device):
    with open_motion(f"evdev:{device.place}") as motion:
        device.latest.play((2, 0, 400))
        until(lambda: motion._counts == [400, 0])
        assert motion.read(0) == (0, 0)
        device.latest.play((2, 0, -800))
        await_mm(motion, (-25.4, 0))


def test_lost_events_are_reported_once(device):
    with open_motion("evdev:") as motion:
        motion.read(0)
        device.latest.play((0, 3, 0), (0, 3, 0), (2, 1, 800))
        await_mm(motion, (0, 25.4))
        assert len(motion.notes) == 1


def test_a_mouse_that_is_pulled_out_ends_the_run(device):
    with open_motion("evdev:") as motion:
        device.latest.pull_out()
        motion._thread.join(10)
        with raises(SourceLostError, value=device.place):
            motion.read(0)


def test_the_first_mouse_is_found_among_others(device, monkeypatch):
    kinds = {"/dev/input/event10": (0, 1), "/dev/input/event2": (8,), "/dev/input/event3": (0, 1)}

    class Several(device):
        def __init__(self, path, readonly=False):
            super().__init__(path, readonly)
            self.moves = kinds[path]

    monkeypatch.setattr(sys.modules["evdev"], "InputDevice", Several)
    monkeypatch.setattr(sys.modules["evdev"], "list_devices", lambda: list(kinds))
    with open_motion("evdev:") as motion:
        assert motion._path == "/dev/input/event3"


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
    assert "usermod" in str(caught.value), "the group that may read it is to be joined"
    with raises(SourceError, value="/dev/input/none"):
        open_motion("evdev:/dev/input/none")
    with raises(SourceError, value=1, allowed=(10, 100_000)):
        open_motion("evdev:", cpi=1)


def test_without_the_extra_it_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "evdev", None)
    with raises(SourceError, names="extra"):
        open_motion("evdev:")
