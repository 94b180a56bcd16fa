"""
Analyze a recording
===================

A run is recorded, and its numbers come back as arrays.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# A run to look at: any recording of ``smarttouch live --record`` will do.
path = Path(mkdtemp()) / "run.mcap"
st.run("text:touch", "simulated:", seconds=2, listeners=[st.Recorder(path)])

# %%
# The slots of all steps follow one another: ``first_slot`` says where those of each step begin.
run = st.load_recording(path)
arrays = run.arrays
slots = np.diff(arrays.first_slot)
strongest_ua = np.zeros(len(slots), int)
slot_ua = np.abs(arrays.current_ua.astype(int)).max(axis=1)
np.maximum.at(strongest_ua, np.repeat(np.arange(len(slots)), slots), slot_ua)
print(f"{len(slots)} steps of {slots.mean():.1f} slots, {strongest_ua.max() / 1000} mA at most")
figure, (strongest, activation) = plt.subplots(2, sharex=True, layout="constrained")
strongest.plot(arrays.time_ns / 1e9, strongest_ua / 1000)
strongest.set_ylabel("strongest, mA")
activation.imshow(
    arrays.activation[:, st.Afferent.RA].T, aspect="auto", cmap="Greys",
    extent=(0, run.seconds, 64, 0),
)  # fmt: skip
activation.set(xlabel="time, s", ylabel="electrode, RA")
plt.show()
