"""
An array of your own
====================

Describe an electrode array in a profile, then make its kernels, tactile images and scan sequences.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# Write the profile of 5 x 5 discs with a diameter of 1.0 mm and a pitch of 2.0 mm. To begin from a
# profile with comments, run ``smarttouch profiles new mine.toml``; the reference explains each key.
PROFILE = """
title = "An array of my own: 5 x 5 discs of 1.0 mm at 2.0 mm"

[array]
layout = "grid"
rows = 5
columns = 5
pitch_x_mm = 2.0
pitch_y_mm = 2.0
diameter_mm = 1.0

[skin]  # depths of the paper, Section II-D
medium = "half-space"
conductivity_s_per_m = 0.43
ra_depth_mm = 0.7
sai_depth_mm = 0.9
pc_depth_mm = 2.0
sai_angles_deg = [0.0, 45.0, 90.0, 135.0]
node_spacing_mm = 0.1

[output]
kind = "weighted"

[optics]  # a field of 5 mm on the page, magnified 3.2 times onto the array
sensor_columns = 64
sensor_rows = 64
field_width_mm = 5.0
field_height_mm = 5.0
magnification = 3.2

[force]
law = "linear"
contact_n = 0.15
full_n = 0.9

[pulse]
width_us = 200
discharge_us = 100
rate_hz = 50.0

[limits]  # each at most its ceiling (page *Limits*)
current_ma = 5.0
total_ma = 10.0
pulse_us = 200.0
charge_uc = 0.5
rate_hz = 200.0
duty = 0.8
ramp_s = 0.5
density_uc_cm2 = 100.0
session_s = 3600.0
session_mc = 1800.0

[frames]
share = true

[perception]  # estimates until `smarttouch calibrate thresholds` measures a person
threshold_ma = 1.2
comfort_ratio = 2.0
pc_shift_mm = [0.0, -2.0]
"""
path = Path(mkdtemp()) / "own.toml"
path.write_text(PROFILE, encoding="utf-8")
profile = st.load_profile(path)

# %%
# Load a profile with two mistakes. The error lists both.
path.with_name("wrong.toml").write_text(PROFILE.replace("rows = 5", "rows = 500\ncolour = 3"))
try:
    st.load_profile(path.with_name("wrong.toml"))
except st.ProfileError as error:
    print(*(sentence for _, sentence in error.complaints), sep="\n")

# %%
# Design the kernel of the middle site, then all kernels, which `load_kernels` caches for next time.
kernel = st.design_kernel(profile, "RA", 12)
print(f"site 12: off-target {kernel.off_target:.3f}, at {kernel.off_target_class.name}")
kernels = st.load_kernels(profile)


# %%
# Define a source: a class with the method `read`.
class Wipe(st.OpticalSource):
    """Source of frames: a black bar that moves over white paper within a second."""

    knows_force = True

    def read(self, time_ns):
        if time_ns >= 1e9:
            return None
        image = np.full((64, 64), 255, np.uint8)
        left = int(time_ns / 1e9 * 50)
        image[:, left : left + 14] = 0
        self.frames += 1
        return st.Frame(image, time_ns, force_n=0.9, number=self.frames - 1)


# %%
# Process all frames without a board and without waiting.
steps = list(st.steps(Wipe("a bar"), profile, mode="RA", kernels=kernels))

# %%
# Run the source on a display, which sends only sequences that it has proved safe.
strongest_ma: list[float] = []
with st.open_display("simulated:", profile) as display:
    statistics = st.run(
        Wipe("a bar"),
        display,
        mode="RA",
        listeners=[lambda result: strongest_ma.append(result.delivered_ma.max())],
    )
print(f"{statistics.frames} frames, {statistics.slots} slots; peak {max(strongest_ma):.2f} mA")

# %%
figure, (seen, touched, sent) = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
middle = steps[len(steps) // 2]
seen.imshow(middle.input.image, cmap="gray", vmin=0, vmax=255)
seen.set_title("frame")
activation = middle.tactile.activation[st.Afferent.RA].reshape(5, 5)
touched.imshow(activation, cmap="Greys", vmin=0, vmax=1)
touched.set_title("tactile image, RA")
most_ma = np.abs(middle.sequence.current_ua).max() / 1000
image = sent.imshow(
    middle.sequence.current_ua / 1000, cmap="PuOr_r", vmin=-most_ma, vmax=most_ma, aspect="auto"
)
sent.set(title="sequence", xlabel="electrode", ylabel="slot")
figure.colorbar(image, label="mA, cathodic positive")
plt.show()
