"""Stops, signals and pauses at random instants.

A few of each by default; ``SMARTTOUCH_STRESS=100`` makes it 300 signals (100 of them with a
terminal that has stopped reading), 100 starting runs and 200 pauses on each driver.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.processes import Forked

COUNT = int(os.environ.get("SMARTTOUCH_STRESS", "1"))
WITHIN_S = float(os.environ.get("SMARTTOUCH_STRESS_WITHIN_S", "inf"))
"""Give 1 on a quiet machine: only there it is the run that takes the time."""
SEED = int(os.environ.get("SMARTTOUCH_STRESS_SEED", "1"))
ZERO_MS = float(os.environ.get("SMARTTOUCH_STRESS_ZERO_MS", "1000"))
"""From a signal to the last pulse: give 101 on a quiet machine, where no board waits for it."""
pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240 + 60 * COUNT)]


def stress(*given):
    """Run the script beside this one; return what it found."""
    command = [sys.executable, Path(__file__).with_name("runs.py"), *map(str, given)]
    with Forked(command, stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()
    assert process.returncode == 0
    return json.loads(said)


def test_signals_end_runs_with_the_board_at_zero():
    runs = stress("signals", 3 * COUNT, COUNT, SEED)
    assert len(runs) == 3 * COUNT
    for run in runs:
        assert run["code"] is not None, run
        assert run["took_s"] <= WITHIN_S, run
        assert (run["driving"], run["wrong"]) == (False, 0), run
        if run["zero_after_ms"] is not None:
            assert run["zero_after_ms"] <= ZERO_MS, run


def test_no_starting_run_survives_a_stop():
    runs = stress("stops", max(4, COUNT), SEED)
    assert len(runs) >= max(COUNT, 4)
    for run in runs:
        # A run that drove its board was found; one that was only starting opened none.
        assert run["stop"] == 0 or (run["stop"] == 1 and not run["pulses"]), run
        assert run["code"] in (0, 143), run
        assert (run["driving"], run["wrong"]) == (False, 0), run
