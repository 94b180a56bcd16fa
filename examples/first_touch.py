"""
First touch
===========

A virtual finger reads a word. SmartTouch turns each frame of the sensor into a tactile image (how
strongly each electrode is to be felt) and then into a scan sequence (the currents to send). This
program draws a frame, its tactile image and its sequence, then sends the word to an emulated board.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# A profile describes one device on one finger: electrodes, skin, limits. `steps` processes all
# frames of a source without a board and without waiting.
profile = st.load_profile("electric-mouse")
source = st.open_source("text:touch", profile, speed_mm_s=60)
steps = list(st.steps(source, profile, mode="RA"))
print(f"{len(steps)} frames; the shipped profiles are {', '.join(st.list_profiles())}")

# %%
# Draw the step that stimulates the most points: its frame, its tactile image and its sequence.
# Orange is cathodic, purple anodic. The currents of each slot add up to zero.
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
# Send the word to a display, which first proves each sequence safe. The board ``simulated:``
# emulates the wire format and the firmware of a board in simulated time. (``emulator:`` is the same
# board in its own process, behind a serial line.) The picture shows the delivered pulses.
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
