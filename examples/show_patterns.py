"""
Show patterns, and plot the currents
====================================

In a session the board is open. A program raises the intensity once, and then shows patterns at any
time. A recording of the session provides the currents as arrays.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

path = Path(mkdtemp()) / "session.mcap"
display = st.open_display("simulated:", "electric-mouse")
place_mm = display.profile.electrodes.position_mm

# %%
# Show a bar at angles of 0, 45 and 90 degrees, for half a second each.


def bar(angle_deg: float) -> np.ndarray:
    """Return the activation of a bar through the middle of the array, (E,)."""
    across = (np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg)))
    away_mm = np.abs((place_mm - place_mm.mean(axis=0)) @ across)
    return np.asarray(away_mm < 1.1, np.float32)


def show_bars(touch: st.Session) -> list[st.Shown]:
    """Show the bar at three angles, one after another."""
    return [touch.show(bar(angle_deg), seconds=0.5) for angle_deg in (0, 45, 90)]


with display.session(mode="RA", intensity=0.6, listeners=[st.Recorder(path)]) as touch:
    print(f"the ramp reached the level after {touch.rise():.2f} s")
    for shown in show_bars(touch):
        print(f"{shown.sequences} sequences, {shown.pulses} pulses, intensity {shown.intensity:g}")

# %%
# Without finger force the ramp cannot reach the level. Then `show` raises an error.
with display.session(mode="RA", intensity=0.6, force="fixed:0") as touch:
    try:
        touch.show(bar(0), seconds=0.5)
    except st.LevelNotReachedError as error:
        print(error)

# %%
# Start patterns on two displays at the same time.
other = st.open_display("simulated:", "electric-mouse")
with display.session(mode="RA") as left, other.session(mode="RA") as right:
    together = st.show_together({left: bar(0), right: bar(90)}, seconds=0.2)
print([each.sequences for each in together.values()])

# %%
# Plot the strongest current of each sequence. The pulses before the first bar belong to the ramp.
recorded: st.RecordedRun = st.load_recording(path)
run = recorded.arrays
of_slot = np.abs(run.current_ua.astype(int)).max(axis=1)
strongest = np.zeros(len(run.step))
np.maximum.at(strongest, np.repeat(run.step, np.diff(run.first_slot)), of_slot)

figure, axis = plt.subplots(figsize=(6, 2.4), layout="constrained")
axis.plot(run.time_ns / 1e9, strongest / 1000, ".", markersize=3)
axis.set(xlabel="time (s)", ylabel="strongest current (mA)")
plt.show()
