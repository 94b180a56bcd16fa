"""Marker of tests that need liblouis."""

import pytest

from smarttouch.braille import louis

needs_liblouis = pytest.mark.skipif(
    louis.version() is None, reason=f"needs liblouis: {louis.INSTALL}"
)
