"""
The electric mouse
==================

A virtual hand moves over a texture. An electrode pulses when a ridge passes under it, so its rate
is the texture's spatial frequency times the hand's speed. A hand at rest gets no pulses.
"""

import math
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import (
    MouseSource,
    open_motion_over,
    open_texture,
    profile_for_reading,
    reading_force_n,
)

own = st.load_profile("electric-mouse")
profile = profile_for_reading(own)


def move(texture, speed_mm_s, listeners):
    """Sweep a virtual hand over a texture; return the statistics of the run."""
    motion = open_motion_over(texture, "sweep:", own, speed_mm_s=speed_mm_s)
    source = MouseSource(texture, motion, profile, rate_hz=100, press_n=reading_force_n(profile))
    display = st.open_display("simulated:", profile)
    return st.run(source, display, mode="RA", rate_hz=100, listeners=listeners)


# %%
# Check on a grating of 4 mm that twice the speed gives twice the pulse rate. The rate is that of
# electrode 27, from its median pulse interval.
grating = open_texture("grating:4mm")
for speed_mm_s in (20, 40, 80):
    pulses_s: list[float] = []

    def note(result, pulses_s=pulses_s):
        if result.tactile.activation[st.Afferent.RA, 27] > 0:
            pulses_s.append(result.input.time_ns / 1e9)

    move(grating, speed_mm_s, [note])
    between_s = np.median(np.diff(pulses_s))
    print(f"{speed_mm_s} mm/s: {1 / between_s:.2f} pulses per second, {speed_mm_s / 4:g} expected")
    assert math.isclose(1 / between_s, speed_mm_s / 4, rel_tol=0.05)

# %%
# Move over a printed word, and draw where the pulses were delivered.
with tempfile.TemporaryDirectory() as folder:
    felt = Path(folder) / "felt.png"
    move(open_texture("text:touch"), 60, [st.DeliveredPicture(felt)])
    picture = plt.imread(felt)
figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
