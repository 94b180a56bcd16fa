"""Two hundred simulated subjects for each procedure: bias, spread, trials, coverage.

Run with::

    pytest tests/benchmarks/test_recovery.py --benchmark-only -n0

Errors are natural logarithms of estimate over truth, so nearly parts of the threshold.
"""

import os

import pytest

from ..experiments.simulated import PROCEDURES, TASKS, recover

SUBJECTS = int(os.environ.get("SMARTTOUCH_SUBJECTS", "200"))


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("task", TASKS)
def test_recovery(task, row, quick):
    subjects = 12 if quick else SUBJECTS
    for name in PROCEDURES:
        found = recover(task, name, subjects, covering=subjects // 2)
        row("Simulated subjects", {"task": task, "procedure": name} | found.cells)
        assert abs(found.fitted.mean()) < (0.2 if quick else 0.05)
        assert found.covered > (0.5 if quick else 0.85)
