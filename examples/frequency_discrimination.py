"""
Frequency discrimination
========================

Which of two trains of pulses was faster? Here a simulated observer answers, who sits at the end
of the whole chain: every train goes through kernels, safety and an emulated board, on the paper's
concentric electrode. What it tests is that chain: the observer's sense of frequency was itself
fitted to the paper's curve. The paper's experiment has 500 trials; this one has fewer, so its
intervals are wide.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt

import smarttouch as st
from smarttouch.lab import (
    Setup,
    discrimination_figure,
    judge_answers,
    make_observer,
    open_experiment,
    read_table,
    usual_model,
)

profile = st.load_profile("concentric")


def sit(folder, standards, repetitions):
    """Let the simulated observer sit the experiment; return its file."""
    setup = Setup(profile, standards=standards, repetitions=repetitions, train_s=0.5, seed=1)
    path = Path(folder) / "frequency-RA.csv"
    with open_experiment("frequency", setup, path, "S1") as sitting:
        source = sitting.source(make_observer("model", profile, 1, finger=2))
        st.run(source, st.open_display("simulated:", profile), seed=1)
    return path


# %%
# Each answer is a row of a CSV file; `fit` finds the thresholds, or reports in a sentence why there
# are none.
with tempfile.TemporaryDirectory() as folder:
    table = read_table(sit(folder, "30", 8))
model = usual_model(table.answers)
findings = [judge_answers(each, model) for each in table.answers]
for found in findings:
    print(found.answers.standard, "Hz:", found.verdict or "has a threshold")

# %%
# Shares judged faster, and the 75 % thresholds.
discrimination_figure([(replace(table, name="RA"), findings)])
plt.show()
