"""Devices by themselves: firmware sent what no gate has proved, and sensors that start slowly."""

import pytest

from smarttouch.sources import force, live_capture


@pytest.fixture
def judges_books():
    """The oracle does not judge firmware that is driven without a gate."""
    return False


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Wait for a first image or reading until a test would hang: how soon it comes says nothing."""
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 60.0)
    monkeypatch.setattr(force, "FIRST_READING_S", 60.0)
