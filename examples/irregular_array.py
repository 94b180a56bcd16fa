"""
An irregular array, from a table
================================

Electrodes where they were printed, not on a grid: kernels are designed for these places, and a
letter runs over them on a simulated board.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import smarttouch as st

# %%
# A table as a layout program writes it: 5 x 6 electrodes, each off its grid by up to 0.3 mm.
folder = Path(mkdtemp())
off_mm = np.random.default_rng(1).uniform(-0.3, 0.3, (30, 2))
places_mm = np.stack(np.meshgrid(np.arange(6) * 2.2, np.arange(5) * 2.2), -1).reshape(-1, 2)
header = "x_mm,y_mm"
np.savetxt(folder / "array.csv", places_mm + off_mm, "%.3f", ",", header=header, comments="")

# %%
# All but the places is that of a shipped profile. ``smarttouch profiles new array.csv mine.toml``
# writes the same as a file to be edited.
profile = st.load_profile("electric-mouse").with_electrodes(folder / "array.csv", "printed array")
kernels = st.load_kernels(profile)
print(f"RA: other classes reach {kernels.off_target[st.Afferent.RA].max():.2f} of the target")
statistics = st.run("text:A", st.open_display("simulated:", profile), seconds=1)
print(f"{statistics.frames} frames, {statistics.slots} slots")
