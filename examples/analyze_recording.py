"""
Analyze a recording
===================

Record a run, load the recording, and plot its currents and activation from arrays.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# Record a run of two seconds. A recording of ``smarttouch live --record`` works as well.
path = Path(mkdtemp()) / "run.mcap"
st.run("text:touch", "simulated:", seconds=2, listeners=[st.Recorder(path)])

# %%
# Arrays such as ``current_ua`` hold the slots of all steps, one after another. ``first_slot`` is
# the index of the first slot of each step.
run = st.load_recording(path)
arrays = run.arrays
slots = np.diff(arrays.first_slot)
strongest_ua = np.zeros(len(slots), int)
slot_ua = np.abs(arrays.current_ua.astype(int)).max(axis=1)
np.maximum.at(strongest_ua, np.repeat(np.arange(len(slots)), slots), slot_ua)
print(f"{len(slots)} steps, on average {slots.mean():.1f} slots; peak {strongest_ua.max()} µA")
figure, (strongest, activation) = plt.subplots(2, sharex=True, layout="constrained")
strongest.plot(arrays.time_ns / 1e9, strongest_ua / 1000)
strongest.set_ylabel("peak current, mA")
activation.imshow(
    arrays.activation[:, st.Afferent.RA].T, aspect="auto", cmap="Greys",
    extent=(0, run.seconds, 64, 0),
)  # fmt: skip
activation.set(xlabel="time, s", ylabel="electrode (RA activation)")
plt.show()
