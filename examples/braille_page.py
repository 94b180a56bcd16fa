"""
Braille of a page
=================

A text becomes Braille cells, cells become dots that pass under the finger, and what an emulated
board delivered of them is read back. English grade 1 is built in; other languages and
contractions come from liblouis.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import smarttouch as st
from smarttouch.lab import (
    Braille,
    ReadingMaterial,
    ReadingSource,
    lay_out,
    open_table,
    profile_for_reading,
)

# %%
# Cells, and back.
table = open_table("en-1")
cells = table.to_cells("Touch what a sensor sees.")
print("\n".join(line for page in lay_out([cells], columns=16) for line in page))
print(table.to_text(cells))

# %%
# The same text under the finger. `smarttouch read photo.jpg --as braille` does this with a page
# that Tesseract has read.
own = st.load_profile("electric-mouse")
profile = profile_for_reading(own)
braille = Braille("en-1")
text = ReadingMaterial("text:a sensor sees")
lines = braille.lines(text, profile)
with tempfile.TemporaryDirectory() as folder:
    felt = Path(folder) / "felt.png"
    source = ReadingSource(text.title, profile, lines, braille.motion(profile, 20.0))
    source.line(0, wait=True)
    display = st.open_display("simulated:", profile)
    statistics = st.run(
        source, display, mode="RA", tone=braille.tone, listeners=[st.DeliveredPicture(felt)]
    )
    source.close()
    picture = plt.imread(felt)
print(f"{statistics.slots} slots in {statistics.frames} frames")

# %%
# Above what passed under the finger, below the delivered pulses.
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
