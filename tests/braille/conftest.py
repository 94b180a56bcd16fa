"""Life without liblouis."""

import pytest

from smarttouch.braille import louis


@pytest.fixture
def no_liblouis(monkeypatch):
    monkeypatch.setattr(louis, "_library", lambda: None)
