"""Tests as if liblouis were not installed."""

import pytest

from smarttouch.braille import louis


@pytest.fixture
def no_liblouis(monkeypatch):
    monkeypatch.setattr(louis, "_library", lambda: None)
