"""
A board of your own
===================

To support a board, write a driver: a class with three methods. `Board` does the rest: it proves
each sequence safe, limits the dose, and sets all electrodes to zero at the end. The driver in this
example stores sequences in a list. For a serial board, read the page *A board of your own*, which
also shows tests and a package, so that ``smarttouch live --board NAME:`` finds the driver.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.plugins import Capabilities, Line, ProvedSequence


class ListDriver(st.Driver):
    """Driver that stores each sequence in a list."""

    def __init__(self) -> None:
        self.sequences: list[st.ScanSequence] = []

    def open(self, line: Line, limits: st.SafetyLimits) -> Capabilities:
        self.line = line
        return Capabilities(
            limits.electrodes, "weighted", limits.current_ma, max_slots=1000,
            time_to_zero_ms=0.0, firmware="list 1.0",
        )  # fmt: skip

    def write(self, proved: ProvedSequence) -> None:
        with self.line.current(proved):
            self.sequences.append(proved.sequence)

    def zero(self) -> None:
        """Do nothing: a list drives no current."""


# %%
# Run a source on the board. No finger can touch this board, so the gate may use the times stated in
# sequences (``claimed_time``) instead of a clock.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:a", profile, speed_mm_s=60)
driver = ListDriver()
limits = st.SafetyLimits.of(profile)
board = st.Board(driver, limits, profile.output, on_a_finger=False, claimed_time=True)
with st.open_display(board, profile) as display:
    statistics = st.run(source, display, mode="RA")
print(f"{statistics.frames} frames, {len(driver.sequences)} sequences")

# %%
# Try to change a proved sequence: it is read-only. Then try to send a sequence with five times the
# current: the safety gate rejects it.
sequence = max(driver.sequences, key=lambda each: each.slots)
try:
    sequence.current_ua[0] = 5000
except ValueError as error:
    print(error)
with board:
    try:
        board.send(replace(sequence, current_ua=(5 * sequence.current_ua).astype(np.int16)))
    except st.SafetyError as error:
        print(error)

# %%
# Draw the received sequence that has the most slots.
current_ma = sequence.current_ua / 1000
most_ma = np.abs(current_ma).max()
figure, axes = plt.subplots(figsize=(7, 2.4), layout="constrained")
drawn = axes.imshow(current_ma, cmap="PuOr_r", vmin=-most_ma, vmax=most_ma, aspect="auto")
axes.set(xlabel="electrode", ylabel="slot")
figure.colorbar(drawn, label="mA, cathodic positive")
plt.show()
