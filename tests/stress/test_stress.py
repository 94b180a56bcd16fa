"""Stops and signals at random instants.

A few of each by default; ``--runs 100 --timeout 0`` makes it 300 signals and 100 starting runs.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.processes import Forked

SEED = 1
LONGEST_MS = 1000
"""From a signal to the last pulse, on a busy machine; 101 are enough on a quiet one."""
pytestmark = pytest.mark.realtime


def stress(*given):
    """Run the script beside this one; return what it found."""
    command = [sys.executable, Path(__file__).with_name("runs.py"), *map(str, given)]
    with Forked(command, stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()
    assert process.returncode == 0
    return json.loads(said)


def test_signals_end_runs_with_the_board_at_zero(runs):
    count = runs or 1
    ended = stress("signals", 3 * count, SEED)
    assert len(ended) == 3 * count
    for run in ended:
        assert run["code"] is not None, run
        assert (run["driving"], run["wrong"]) == (False, 0), run
        if run["zero_after_ms"] is not None:
            assert run["zero_after_ms"] <= LONGEST_MS, run


def test_no_starting_run_survives_a_stop(runs):
    count = runs or 4
    started = stress("stops", count, SEED)
    assert len(started) >= count
    for run in started:
        # A run that drove its board was found; one that was only starting opened none.
        assert run["stop"] == 0 or (run["stop"] == 1 and not run["pulses"]), run
        assert run["code"] in (0, 143), run
        assert (run["driving"], run["wrong"]) == (False, 0), run
