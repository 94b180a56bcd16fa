"""
An irregular array, from a table
================================

The electrodes of this array are not on a grid. Kernels are designed for the positions in a table,
and a letter is shown with these kernels on a simulated board.
"""

from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import smarttouch as st

# %%
# Write a table of the positions of 5 x 6 electrodes. Each is off a grid by up to 0.3 mm.
folder = Path(mkdtemp())
off_mm = np.random.default_rng(1).uniform(-0.3, 0.3, (30, 2))
places_mm = np.stack(np.meshgrid(np.arange(6) * 2.2, np.arange(5) * 2.2), -1).reshape(-1, 2)
header = "x_mm,y_mm"
np.savetxt(folder / "array.csv", places_mm + off_mm, "%.3f", ",", header=header, comments="")

# %%
# Take everything except the positions from a shipped profile. To edit such a profile as a file, run
# ``smarttouch profiles new array.csv mine.toml``.
profile = st.load_profile("electric-mouse").with_electrodes(folder / "array.csv", "printed array")
kernels = st.load_kernels(profile)
print(f"RA kernels: largest off-target activation {kernels.off_target[st.Afferent.RA].max():.2f}")
statistics = st.run("text:A", st.open_display("simulated:", profile), seconds=1)
print(f"{statistics.frames} frames, {statistics.slots} slots")
