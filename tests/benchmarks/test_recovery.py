"""Two hundred simulated subjects for each procedure: bias, spread, trials, coverage.

Run with::

    pytest tests/benchmarks/test_recovery.py --benchmark-only -n0 -s

Errors are natural logarithms of estimate over truth, so nearly parts of the threshold.
"""

import os

import pytest

from ..experiments.recovery import PROCEDURES, TASKS, recover

SUBJECTS = int(os.environ.get("SMARTTOUCH_SUBJECTS", "200"))


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("task", TASKS)
def test_recovery(task, benchmark):
    def go():
        print(f"\n{task:14}trials none   fit: bias, SD (n)     own: bias, SD (n)    covered")
        for name in PROCEDURES:
            found = recover(task, name, SUBJECTS, covering=SUBJECTS // 2)
            print(f"{name:14}{found.line}")
            assert abs(found.fitted.mean()) < 0.05
            assert found.covered > 0.85

    benchmark.pedantic(go, rounds=1)
