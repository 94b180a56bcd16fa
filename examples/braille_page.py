"""
Braille of a page
=================

This program translates a text into Braille cells, moves the dots of the cells under a virtual
finger, and draws the pulses that an emulated board delivered. English grade 1 is built in. For
other languages and contractions, install liblouis.
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
# Translate a sentence into cells, print the page, and translate the cells back.
table = open_table("en-1")
cells = table.to_cells("Touch what a sensor sees.")
print("\n".join(line for page in lay_out([cells], columns=16) for line in page))
print(table.to_text(cells))

# %%
# Move a line of Braille under the finger. `smarttouch read photo.jpg --as braille` does the same
# with the text that Tesseract recognizes in a photograph.
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
# Show the line that passed under the finger (top) and the delivered pulses (bottom).
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
