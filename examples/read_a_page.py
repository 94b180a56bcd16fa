"""
Read a photographed page
========================

A soft, unevenly lit and slightly turned photograph of a page is made flat and level, its lines
are found, and each moves under the finger, magnified so that it fills the rows of the array.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import smarttouch as st
from smarttouch.lab import (
    ReadingMaterial,
    ReadingSource,
    Shapes,
    data_folder,
    profile_for_reading,
)

# %%
# The photograph.
path = data_folder("sample_images") / "photo.png"
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.imshow(plt.imread(path), cmap="gray")
axes.set_axis_off()

# %%
# The first five seconds of reading it. `smarttouch read photo.png` does the same in a terminal,
# with keys for lines and pauses.
own = st.load_profile("electric-mouse")
profile = profile_for_reading(own)
shapes = Shapes()
text = ReadingMaterial(str(path))
lines = shapes.lines(text, profile)
with tempfile.TemporaryDirectory() as folder:
    felt = Path(folder) / "felt.png"
    source = ReadingSource(text.title, profile, lines, shapes.motion(profile))
    source.line(0, wait=True)
    with st.open_display("simulated:", profile) as display:
        statistics = st.run(
            source, display, tone=shapes.tone, seconds=5, listeners=[st.DeliveredPicture(felt)]
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
