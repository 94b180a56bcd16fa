"""Whether tests that repeat one thing do all of it: with ``pytest --full``, as in CI."""

import os
import sys

_FOR_WORKERS = "PYTEST_SMARTTOUCH_FULL"  # workers of pytest-xdist have no arguments of their own

WHOLE = "--full" in sys.argv or _FOR_WORKERS in os.environ
if WHOLE:
    os.environ[_FOR_WORKERS] = "1"


def sample(every, step=2):
    """Return all of several, or each so many of them."""
    return list(every)[:: 1 if WHOLE else step]
