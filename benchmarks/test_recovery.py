"""Two hundred simulated subjects for each procedure: bias, spread, trials, coverage.

Errors are natural logarithms of estimate over truth, so nearly parts of the threshold.
"""

import pytest

from tests.experiments.simulated import PROCEDURES, TASKS, recover


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("task", TASKS)
def test_recovery(task, row, quick, runs):
    subjects = 12 if quick else runs or 200
    for name in PROCEDURES:
        found = recover(task, name, subjects)
        row("Simulated subjects", {"task": task, "procedure": name} | found.cells)
        assert abs(found.fitted.mean()) < (0.2 if quick else 0.05)
        assert found.covered > (0.5 if quick else 0.9)
