"""
An array of your own
====================

From a profile, a text of a few lines, to kernels, tactile images, sequences and a run.
"""

from pathlib import Path
from tempfile import mkdtemp

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# 5 x 5 discs of 1.0 mm at 2.0 mm. ``smarttouch profiles new mine.toml`` writes a
# profile with comments to begin from; the reference explains every key.
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

[optics]  # 5 mm of page under 10 mm of skin
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

[limits]  # may be lower than the ceilings, never higher
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

[perception]  # until a calibration measures them
threshold_ma = 1.2
comfort_ratio = 2.0
pc_shift_mm = [0.0, -2.0]
"""
path = Path(mkdtemp()) / "own.toml"
path.write_text(PROFILE, encoding="utf-8")
profile = st.load_profile(path)

# %%
# What is wrong in a profile is said all at once.
path.with_name("wrong.toml").write_text(PROFILE.replace("rows = 5", "rows = 500\ncolour = 3"))
try:
    st.load_profile(path.with_name("wrong.toml"))
except st.ProfileError as error:
    print(*(sentence for _, sentence in error.complaints), sep="\n")

# %%
# Kernels are designed once and kept for the next time. Positive is cathodic.
kernel = st.design_kernel(profile, "RA", 12)
print(f"the middle one reaches {kernel.off_target_class.name} by {kernel.off_target:.3f}")
kernels = st.load_kernels(profile)


# %%
# A source of your own is a class with one method.
class Wipe(st.OpticalSource):
    """A black bar that wipes over white paper in a second."""

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
# Each frame with its tactile image and sequence, without a board or a clock.
steps = list(st.steps(Wipe("a bar"), profile, mode="RA", kernels=kernels))

# %%
# The same on a display, which proves each sequence safe before it is sent.
strongest_ma: list[float] = []
with st.open_display("simulated:", profile) as display:
    statistics = st.run(
        Wipe("a bar"),
        display,
        mode="RA",
        listeners=[lambda result: strongest_ma.append(result.delivered_ma.max())],
    )
print(f"{statistics.frames} frames, {statistics.slots} slots, {max(strongest_ma):.2f} mA at most")

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
