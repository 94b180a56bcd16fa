"""Recovery of the thresholds of 200 simulated subjects with each procedure.

An error is the natural logarithm of the ratio of the estimated threshold to the true one.
"""

import numpy as np
import pytest

from tests.experiments.test_procedures import AS_USED, recover


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("task", "name"), AS_USED)
def test_recovery(task, name, row, quick, runs):
    subjects = 12 if quick else runs or 200
    errors, held, trials = recover(task, name, subjects)
    row("Recovered thresholds of simulated subjects", {
        "task": task, "procedure": name, "trials": f"{np.mean(trials):.1f}",
        "subjects without threshold": subjects - len(errors),
        "mean error, SD": f"{np.mean(errors):+.3f}, {np.std(errors):.3f}",
        "share of 95 % intervals that hold the truth": f"{np.mean(held):.3f}",
    })  # fmt: skip
    assert abs(np.mean(errors)) < (0.2 if quick else 0.05)
    assert np.mean(held) > (0.5 if quick else 0.88)
