"""
A board of your own
===================

A board has a driver: a class with three methods. `Board` does the rest: it proves each sequence
safe, counts the dose, and ends in zero. This driver keeps what it is sent in a list. One with a
wire, packed so that ``smarttouch live --board NAME:`` finds it, and with the tests that it must
pass, is in the how-to *A board of your own*.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.plugins import Capabilities, Line, ProvedSequence


class ListDriver(st.Driver):
    """Keeps each sequence in a list."""

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
        """A list is always at zero."""


# %%
# Put a run on it. A list makes no current: no finger is on this board, and its time is what
# sequences state.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:a", profile, speed_mm_s=60)
driver = ListDriver()
limits = st.SafetyLimits.of(profile)
board = st.Board(driver, limits, profile.output, on_a_finger=False, claimed_time=True)
with st.open_display(board, profile) as display:
    statistics = st.run(source, display, mode="RA")
print(f"{statistics.frames} frames, {len(driver.sequences)} sequences")

# %%
# Every sequence that arrives has been proved, and cannot be written to. What is not safe does not
# arrive: here each current is five times as strong.
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
# The sequence with most slots, as the board got it.
current_ma = sequence.current_ua / 1000
most_ma = np.abs(current_ma).max()
figure, axes = plt.subplots(figsize=(7, 2.4), layout="constrained")
drawn = axes.imshow(current_ma, cmap="PuOr_r", vmin=-most_ma, vmax=most_ma, aspect="auto")
axes.set(xlabel="electrode", ylabel="slot")
figure.colorbar(drawn, label="mA, cathodic positive")
plt.show()
