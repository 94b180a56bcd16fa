"""
Frequency discrimination
========================

Which of two pulse trains had the higher frequency? A simulated observer answers, from the pulses
that an emulated board delivers to the paper's concentric electrode. The example therefore tests the
software from kernels to board. It does not test the paper, because the observer was fitted to the
paper's curve. The paper has 500 trials; this program has fewer, so its credible intervals are wide.
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
    """Run the experiment with the simulated observer, and return the file of answers."""
    setup = Setup(profile, standards=standards, repetitions=repetitions, train_s=0.5, seed=1)
    path = Path(folder) / "frequency-RA.csv"
    with open_experiment("frequency", setup, path, "S1") as sitting:
        source = sitting.source(make_observer("model", profile, 1, finger=2))
        st.run(source, st.open_display("simulated:", profile), seed=1)
    return path


# %%
# Run the experiment, which writes each answer as a row of a CSV file, and fit the answers.
# `judge_answers` returns the thresholds, or the reason why the answers do not determine one.
with tempfile.TemporaryDirectory() as folder:
    table = read_table(sit(folder, "30", 8))
model = usual_model(table.answers)
findings = [judge_answers(each, model) for each in table.answers]
for finding in findings:
    print(finding.answers.standard, "Hz:", finding.verdict or "threshold determined")

# %%
# Draw the share of "faster" answers over the comparison frequency, with the 75 % thresholds.
discrimination_figure([(replace(table, name="RA"), findings)])
plt.show()
