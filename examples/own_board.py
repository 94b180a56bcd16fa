"""
A board of your own
===================

A board is a class with three methods. `Board` does the rest: it proves each sequence safe, counts
the dose, and ends in zero. This one keeps what it is sent in a list. One with a wire, packed so
that ``smarttouch live --board NAME:`` finds it, and with the tests that it must pass, is in the
how-to *A board of your own*.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.types import Output


class ListBoard(st.Board):
    """Keeps each sequence in a list."""

    on_a_finger = False  # a list makes no current; a board that does leaves this out

    def __init__(self, rest: str, limits: st.SafetyLimits, output: Output | None = None) -> None:
        super().__init__(
            limits,
            output,
            max_current_ma=limits.current_ma,
            max_slots=1000,
            time_to_zero_ms=0.0,
            firmware="list 1.0",
            clock="host",
        )
        self.sequences: list[st.ScanSequence] = []

    def _send(self, sequence: st.ScanSequence, times: int) -> int:
        self.sequences.append(sequence)
        self.acknowledged += 1
        return len(self.sequences)

    def _stop(self) -> None:
        """A list is always at zero."""


# %%
# Put a run on it.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:a", profile, speed_mm_s=60)
with st.open_display(ListBoard, profile) as display:
    statistics = st.run(source, display, mode="RA")
    board = display.board
    assert isinstance(board, ListBoard)
print(f"{statistics.frames} frames, {len(board.sequences)} sequences")

# %%
# Every sequence that arrives has been proved, and cannot be written to. What is not safe does not
# arrive: here each current is five times as strong.
sequence = max(board.sequences, key=lambda each: each.slots)
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
