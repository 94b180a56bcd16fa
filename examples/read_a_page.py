"""
Read a photographed page
========================

The photograph of a page is blurred, unevenly lit and slightly rotated. SmartTouch corrects it and
finds its lines. Then each line moves under the finger, magnified to the height of the array.
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
# Show the photograph.
path = data_folder("sample_images") / "photo.png"
figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
axes.imshow(plt.imread(path), cmap="gray")
axes.set_axis_off()

# %%
# Read for five seconds. `smarttouch read photo.png` does the same in a terminal, where keys change
# the line or pause.
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
# Show the line that passed under the finger (top) and the delivered pulses (bottom).
figure, axes = plt.subplots(figsize=(9, 3), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
