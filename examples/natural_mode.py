"""
Natural mode: edges vibrate, areas press
========================================

In a finger that moves over print, Meissner corpuscles (RA) respond to changes and Merkel cells
(SAI) to steady pressure. Natural mode stimulates both classes, each with its own kernels: RA where
the frame changes, SAI where the frame shows ink.
"""

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st

# %%
# Process frames of a disc that moves under the finger, rests there, and moves away.


class PassingDisc(st.OpticalSource):
    """Source of frames: a black disc that arrives, rests for 0.8 s and leaves."""

    knows_force = True
    path_s, path_mm = (0.0, 0.4, 1.2, 1.6), (-8.0, 0.0, 0.0, 8.0)

    def read(self, time_ns):
        if time_ns >= 1.6e9:
            return None
        middle_mm = np.interp(time_ns / 1e9, self.path_s, self.path_mm)
        place_mm = (np.arange(64) - 31.5) * 10 / 64
        disc = np.hypot(place_mm[None, :] - middle_mm, place_mm[:, None]) < 3
        self.frames += 1
        image = np.where(disc, 20, 230).astype(np.uint8)
        return st.Frame(image, time_ns, force_n=0.9, number=self.frames - 1)


profile = st.load_profile("electric-mouse")
steps = list(st.steps(PassingDisc("a disc"), profile, mode="natural"))
print(f"{len(steps)} sequences, {sum(step.sequence.slots for step in steps)} slots")

# %%
# Plot the summed activation of each class over time.
time_s = [step.tactile.time_ns / 1e9 for step in steps]
figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
for afferent, color in ((st.Afferent.RA, "#d55e00"), (st.Afferent.SAI, "#0072b2")):
    drive = [step.tactile.activation[afferent].sum() for step in steps]
    axes.plot(time_s, drive, color=color, label=afferent.name)
axes.set(xlabel="time (s)", ylabel="summed activation")
axes.legend(frameon=False)

# %%
# Draw the frame and both activations while the disc arrives (top) and while it rests (bottom).
coming, resting = (
    min(steps, key=lambda each: abs(each.tactile.time_ns / 1e9 - t)) for t in (0.3, 1)
)
figure, panels = plt.subplots(2, 3, figsize=(6, 4), layout="constrained")
for row, step, name in zip(panels, (coming, resting), ("coming in", "at rest"), strict=True):
    row[0].imshow(step.input.image, cmap="gray", vmin=0, vmax=255)
    row[0].set_ylabel(name)
    for axes, afferent in zip(row[1:], (st.Afferent.RA, st.Afferent.SAI), strict=True):
        activation = step.tactile.activation[afferent].reshape(8, 8)
        axes.imshow(activation, cmap="Greys", vmin=0, vmax=1)
        axes.set_title(afferent.name)
for axes in panels.flat:
    axes.set(xticks=[], yticks=[])
plt.show()
