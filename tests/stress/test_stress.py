"""Signals at random instants: ``--runs 300 --timeout 0`` for many."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.processes import Forked

LONGEST_MS = 1000
"""From a signal to the last pulse, on a busy machine; 101 are enough on a quiet one."""


@pytest.mark.realtime
def test_signals_end_runs_with_the_board_at_zero(runs):
    count = runs or 3
    command = [sys.executable, Path(__file__).with_name("runs.py"), str(count), "1"]
    with Forked(command, stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()
    ended = json.loads(said)
    assert (process.returncode, len(ended)) == (0, count)
    for run in ended:
        assert run["code"] is not None, run
        assert (run["driving"], run["wrong"]) == (False, 0), run
        assert (run["zero_after_ms"] or 0) <= LONGEST_MS, run
