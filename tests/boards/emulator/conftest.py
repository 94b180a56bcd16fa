"""Firmware by itself, sent what no gate has proved."""

import pytest


@pytest.fixture
def judged_books():
    """The oracle does not judge firmware that is driven without a gate."""
