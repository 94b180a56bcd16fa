"""
An experiment of your own
=========================

In which of two intervals had the bar a gap? A task makes a trial of each condition, a procedure
chooses the conditions, and the terminal, the file of answers and the fit come with it. The
command ``smarttouch experiment run own_experiment.py --subject S1`` runs this file as it stands.
"""

import subprocess
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from smarttouch.lab import Design, Experiment, constant_stimuli, in_two_intervals


class GapTask:
    """A whole bar in one interval, one with a gap in the other."""

    def __init__(self, stimuli):
        self.stimuli = stimuli
        self.x_mm, y_mm = stimuli.profile.electrodes.position_mm.T
        self.row = y_mm == y_mm[stimuli.middle]

    def bar(self, gap_mm):
        return self.stimuli.train(np.flatnonzero(self.row & (abs(self.x_mm) > gap_mm / 2)), 50)

    def trial(self, condition):
        gap, whole = self.bar(condition.comparison), self.bar(0)
        words = f"gap of {condition.comparison:g} mm"
        return in_two_intervals(condition, gap, whole, "gap", "which had a gap?", words, "mm")


def make(stimuli, options, method):
    """Return the task, and gaps of 2 to 10 mm, ten times each if nothing else is asked for."""
    pairs = [(0, gap_mm) for gap_mm in (2, 6, 10)]
    procedure = constant_stimuli(pairs, options.repetitions or 10, seed=options.seed)
    return Design(GapTask(stimuli), procedure, method)


experiment = Experiment("which had a gap: width, mm", make)

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
