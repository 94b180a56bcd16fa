"""
Analyze a recording
===================

A run is recorded, and its numbers come back as arrays and as a table (pandas, extra ``data``).
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt

import smarttouch as st

# %%
# A run to look at: any recording of ``smarttouch live --record`` will do.
path = Path(mkdtemp()) / "run.mcap"
st.run("text:touch", "simulated:", seconds=2, listeners=[st.Recorder(path)])

# %%
run = st.load_recording(path)
table = run.to_dataframe()
by_tenth = table.groupby(table.time_ns // 100_000_000).agg({"slots": "mean", "strongest_ua": "max"})
print(by_tenth.head())
figure, (strongest, activation) = plt.subplots(2, sharex=True, layout="constrained")
strongest.plot(table.time_ns / 1e9, table.strongest_ua / 1000)
strongest.set_ylabel("strongest, mA")
activation.imshow(
    run.arrays.activation[:, st.Afferent.RA].T, aspect="auto", cmap="Greys",
    extent=(0, run.seconds, 64, 0),
)  # fmt: skip
activation.set(xlabel="time, s", ylabel="electrode, RA")
plt.show()
