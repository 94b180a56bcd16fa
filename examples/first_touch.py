"""
First touch
===========

A virtual finger reads a word. For each frame that the sensor sees, SmartTouch makes a tactile
image, how strongly each electrode is to be felt, and from it a scan sequence, the currents that
do it. Here one instant is looked at, then the whole word is put on an emulated board.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# A profile describes one device on one finger: electrodes, skin, limits. `steps` goes through a
# source without a board and without a clock.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:touch", profile, speed_mm_s=60)
steps = list(st.steps(source, profile, mode="RA"))
print(f"{len(steps)} frames; the shipped profiles are {', '.join(st.list_profiles())}")

# %%
# The step with most points: the frame, its tactile image, and the sequence that is sent. Orange
# is cathodic, purple anodic; in each slot the currents add up to zero.
step = max(steps, key=lambda each: each.sequence.points)
rows, columns = profile.array.rows, profile.array.columns
figure, (seen, touched, sent) = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
seen.imshow(step.input.image, cmap="gray", vmin=0, vmax=255)
seen.set_title("frame")
activation = step.tactile.activation[st.Afferent.RA].reshape(rows, columns)
touched.imshow(activation, cmap="Greys", vmin=0, vmax=1)
touched.set_title("tactile image, RA")
current_ma = step.sequence.current_ua / 1000
most_ma = np.abs(current_ma).max()
image = sent.imshow(current_ma, cmap="PuOr_r", vmin=-most_ma, vmax=most_ma, aspect="auto")
sent.set(title="sequence", xlabel="electrode", ylabel="slot")
figure.colorbar(image, label="mA, cathodic positive")

# %%
# The same on a display, which proves each sequence safe before a byte of it is sent. The board
# ``simulated:`` has the firmware of a real protocol, in simulated time; ``emulator:`` is the same
# board in a process of its own, behind a serial line. Its books say what reached the skin.
with tempfile.TemporaryDirectory() as folder:
    felt = Path(folder) / "felt.png"
    source = st.open_source("text:touch", profile, speed_mm_s=60)
    with st.open_display("simulated:", profile) as display:
        statistics = st.run(source, display, mode="RA", listeners=[st.DeliveredPicture(felt)])
    picture = plt.imread(felt)
print(f"{statistics.frames} frames, {statistics.slots} slots delivered")

figure, axes = plt.subplots(figsize=(9, 4.5), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
