"""Fixtures: devices that send data to a port, and long time limits for slow devices."""

import threading

import pytest

from smarttouch.emulator.device_lines import PtyLine
from smarttouch.sources import force, live_capture


class Device(threading.Thread):
    """Thread that sends ``data(number)`` over a line, 100 times per second."""

    def __init__(self, data):
        super().__init__()
        self.line = PtyLine()
        self.data = data
        self._ended = threading.Event()
        self.start()

    def run(self):
        number = 0
        while not self._ended.wait(0.01):
            # Send only if a host has opened the port: it must not receive earlier data.
            if self.line.read(0) is not None:
                self.line.write(self.data(number))
                number += 1

    def close(self):
        self._ended.set()
        self.join()
        self.line.close()


@pytest.fixture
def make_device():
    devices = []

    def make(data):
        devices.append(Device(data))
        return devices[-1]

    yield make
    for device in devices:
        device.close()


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Wait up to 60 s for a first image or reading, because a busy machine can delay it."""
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 60.0)
    monkeypatch.setattr(force, "FIRST_READING_S", 60.0)
