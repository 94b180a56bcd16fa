"""
Kernels of your own array
=========================

A *kernel* is a pattern of currents that stimulates one class of afferents under one electrode, and
all other classes as little as possible. It is the optimum of a linear program, which depends on the
positions of the electrodes and on the skin.
"""

import matplotlib.pyplot as plt

import smarttouch as st
from smarttouch.lab import kernel_figure

# %%
# Design a kernel of each class for the paper's 4 x 4 array. Left: the currents. Right: the
# activating function at the depth of each class, relative to the target (+). RA and SAI can be
# stimulated almost without other classes. PC cannot, because it is the deepest class.
profile = st.load_profile("smarttouch-4x4")
kernels = {each: st.design_kernel(profile, each, 5) for each in st.Afferent}
for each, kernel in kernels.items():
    print(f"{each.name}: off-target {kernel.off_target:.3g}, at {kernel.off_target_class.name}")
kernel_figure(profile, kernels, 5)

# %%
# Compare arrays of different pitch on the same skin. `model_copy` validates a copy like a file.
pitches_mm = [1.5, 2.0, 2.5, 3.0, 4.0]
off_target: dict[str, list[float]] = {"RA": [], "SAI": []}
for pitch_mm in pitches_mm:
    pitches = {"pitch_x_mm": pitch_mm, "pitch_y_mm": pitch_mm}
    other = profile.model_copy(update={"array": profile.array.model_copy(update=pitches)})
    for name, found in off_target.items():
        found.append(st.design_kernel(other, name, 5).off_target)
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for name, found in off_target.items():
    color = {"RA": "#d55e00", "SAI": "#0072b2"}[name]
    axes.plot(pitches_mm, found, "o-", color=color, label=name)
axes.set(xlabel="pitch (mm)", ylabel="off-target, relative to the target")
axes.legend(frameon=False)
plt.show()
