"""Devices at the far end of a port, and patience with those that start slowly."""

import threading

import pytest

from smarttouch.emulator.device_lines import PtyLine
from smarttouch.sources import force, live_capture


class Device(threading.Thread):
    """Sends what `data` returns for a number, 100 times a second."""

    def __init__(self, data):
        super().__init__()
        self.line = PtyLine()
        self.data = data
        self._ended = threading.Event()
        self.start()

    def run(self):
        number = 0
        while not self._ended.wait(0.01):
            # Whoever listens later must not hear what was sent before.
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
    """Wait for a first image or reading until a test would hang: how soon it comes says nothing."""
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 60.0)
    monkeypatch.setattr(force, "FIRST_READING_S", 60.0)
