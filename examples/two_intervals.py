"""
Two intervals and an answer
===========================

Which of two gaps is wider? A session raises the intensity once, and keeps it for up to 15 s without
pulses, so that the subject can answer. `show` raises an error if the finger is lifted meanwhile.
"""

import csv
import sys

import numpy as np

import smarttouch as st

display = st.open_display("simulated:", "electric-mouse")
columns_mm = display.profile.electrodes.position_mm[:, 0]
rng = np.random.default_rng(1)
rows = csv.writer(sys.stdout)


def bars(gap_mm: float) -> np.ndarray:
    """Return the activation of two bars with a gap between them, (E,)."""
    return (np.abs(np.abs(columns_mm) - gap_mm / 2 - 0.5) < 0.6).astype(np.float32)


# %%
# Run trials in which the program always answers correctly. In an experiment with a person, replace
# this answer by ``input("1 or 2? ")``.
with display.session(mode="RA", intensity=0.8) as touch:
    touch.rise()
    for trial in range(8):
        gaps_mm = rng.permutation([2.0, rng.choice([4.0, 6.0])])
        for gap_mm in gaps_mm:
            touch.show(bars(gap_mm), seconds=0.5)
            touch.wait(0.5)
        answer = 1 + int(gaps_mm.argmax())
        rows.writerow([trial, *gaps_mm, answer, gaps_mm[answer - 1] == gaps_mm.max()])
