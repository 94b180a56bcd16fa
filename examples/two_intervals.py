"""
Two intervals and an answer
===========================

Which of two gaps is wider? Each interval is shown at its level from the first pulse to the last, or
is an error: a session opens the level once, and keeps it open while somebody thinks.
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
    """Return activation of two bars beside a gap."""
    return (np.abs(np.abs(columns_mm) - gap_mm / 2 - 0.5) < 0.6).astype(np.float32)


# %%
# A person answers by ``input("1 or 2? ")`` in place of what stands here, on a board of their own.
with display.session(mode="RA", intensity=0.8) as touch:
    touch.rise()
    for trial in range(8):
        gaps_mm = rng.permutation([2.0, rng.choice([4.0, 6.0])])
        for gap_mm in gaps_mm:
            touch.show(bars(gap_mm), seconds=0.5)
            touch.wait(0.5)
        answer = 1 + int(gaps_mm.argmax())
        rows.writerow([trial, *gaps_mm, answer, gaps_mm[answer - 1] == gaps_mm.max()])
