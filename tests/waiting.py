"""Waiting for what another thread or process does, for as long as a busy machine takes."""

import time

HANGS_S = 60.0
"""Only what never comes takes that long."""


def until(holds):
    """Wait until something holds; return what it gives."""
    deadline_s = time.monotonic() + HANGS_S
    while not (found := holds()):
        assert time.monotonic() < deadline_s, "it never came true"
        time.sleep(0.002)
    return found
