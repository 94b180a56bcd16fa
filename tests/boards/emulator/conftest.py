"""Firmware by itself, sent what no gate has proved."""

import pytest


@pytest.fixture
def judged_books():
    """What real firmware lets flow, unasked by a gate, is not what the oracle judges."""
