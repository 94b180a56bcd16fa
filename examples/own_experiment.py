"""
An experiment of your own
=========================

In which of two intervals did the bar have a gap? An experiment is a generator that yields trials
and receives the answers. SmartTouch asks the questions, stores the answers and fits them. To run
the experiment of this file, type ``smarttouch experiment run own_experiment.py --subject S1``.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from smarttouch.lab import Experiment, ask, in_two_intervals


def gaps(setup):
    """Yield trials with two intervals: a bar without a gap, and a bar with a gap."""
    x_mm, y_mm = setup.profile.electrodes.position_mm.T
    row = y_mm == y_mm[setup.place]

    def bar(gap_mm):
        return setup.train(np.flatnonzero(row & (abs(x_mm) > gap_mm / 2)), 50)

    def trial(condition):
        gap, whole = bar(condition.comparison), bar(0)
        return in_two_intervals(condition, gap, whole, "gap", "which had a gap?", "mm")

    yield from ask(setup.constant([(0, gap_mm) for gap_mm in (2, 6, 10)]), trial)


experiment = Experiment("which of two bars had a gap? (result: width of the gap, mm)", gaps)

# %%
# Run the experiment with a simulated subject who guesses. With a person, use the same command with
# ``--board`` instead of ``--simulate``.
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
