"""
An experiment of your own
=========================

In which of two intervals had the bar a gap? An experiment is a generator: it yields a trial, gets
its answer and chooses the next. The terminal, the file of answers and the fit come with it. The
command ``smarttouch experiment run own_experiment.py --subject S1`` runs this file as it stands.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from smarttouch.lab import Experiment, ask, in_two_intervals


def gaps(setup):
    """A whole bar in one interval, one with a gap in the other."""
    x_mm, y_mm = setup.profile.electrodes.position_mm.T
    row = y_mm == y_mm[setup.place]

    def bar(gap_mm):
        return setup.train(np.flatnonzero(row & (abs(x_mm) > gap_mm / 2)), 50)

    def trial(condition):
        gap, whole = bar(condition.comparison), bar(0)
        return in_two_intervals(condition, gap, whole, "gap", "which had a gap?", "mm")

    yield from ask(setup.constant([(0, gap_mm) for gap_mm in (2, 6, 10)]), trial)


experiment = Experiment("which had a gap: width, mm", gaps)

# %%
# Somebody who guesses sits it on a simulated board; with a person it is the same command without
# ``--simulate`` and with ``--board``.
if __name__ == "__main__":
    answers = Path(mkdtemp()) / "answers.csv"
    command = ["experiment", "run", f"{sys.argv[0]}?repetitions=1", "--simulate", "random"]
    done = subprocess.run(
        [sys.executable, "-m", "smarttouch", *command, "--output", answers],
        capture_output=True,
        text=True,
        check=True,
    )
    print(done.stdout, answers.read_text("utf-8"))
