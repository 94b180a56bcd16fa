"""Known thresholds are found again; see tests/benchmarks/test_recovery.py for the large version."""

import numpy as np
import pytest

from .recovery import PROCEDURES, TASKS, recover


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", PROCEDURES)
def test_thresholds_come_back(task, name):
    found = recover(task, name, subjects=24)
    assert found.without <= 8
    # Weber fractions are from 8 to 40 %: what is found has to be told apart from any other.
    assert abs(found.fitted.mean()) < 0.06
    assert found.fitted.std() < 0.16
    assert 20 <= found.trials <= 100


def test_intervals_hold_the_truth():
    found = recover("discrimination", "constant", subjects=12, covering=12)
    assert found.covered >= 9 / 12
    assert np.isfinite(found.fitted).all()
