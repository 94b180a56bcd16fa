"""Fixtures for tests that drive emulated devices without a gate, and wait for slow sensors."""

import pytest

from smarttouch.sources import force, live_capture


@pytest.fixture
def judges_books():
    """Return False: the oracle must not check pulses that no gate has proved."""
    return False


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Wait up to 60 s for a first image or reading, because a busy machine can delay it."""
    monkeypatch.setattr(live_capture, "FIRST_IMAGE_S", 60.0)
    monkeypatch.setattr(force, "FIRST_READING_S", 60.0)
