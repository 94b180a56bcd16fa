"""
The electric mouse
==================

A texture lies still while the hand moves over it: each electrode pulses when a ridge passes under
it, so that the pulse rate is the spatial frequency times the speed, and a hand at rest gets no
pulse.
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
    """Let a virtual hand pass over a texture."""
    motion = open_motion_over(texture, "sweep:", own, speed_mm_s=speed_mm_s)
    source = MouseSource(texture, motion, profile, rate_hz=100, press_n=reading_force_n(profile))
    display = st.open_display("simulated:", profile)
    return st.run(source, display, mode="RA", rate_hz=100, listeners=listeners)


# %%
# A 4 mm grating: twice as fast is twice as many pulses. Counted in the middle of a stroke at
# electrode 27.
grating = open_texture("grating:4mm")
for speed_mm_s in (20, 40, 80):
    pulses_s: list[float] = []

    def note(result, pulses_s=pulses_s):
        if result.tactile.activation[st.Afferent.RA, 27] > 0:
            pulses_s.append(result.input.time_ns / 1e9)

    move(grating, speed_mm_s, [note])
    between_s = np.median(np.diff(pulses_s))
    print(f"{speed_mm_s} mm/s: {1 / between_s:.2f} pulses a second, {speed_mm_s / 4:g} expected")
    assert math.isclose(1 / between_s, speed_mm_s / 4, rel_tol=0.05)

# %%
# A word of 12 mm, and where the pulses were.
with tempfile.TemporaryDirectory() as folder:
    felt = Path(folder) / "felt.png"
    move(open_texture("text:touch"), 60, [st.DeliveredPicture(felt)])
    picture = plt.imread(felt)
figure, axes = plt.subplots(figsize=(9, 5), layout="constrained")
axes.imshow(picture, cmap="gray")
axes.set_axis_off()
plt.show()
