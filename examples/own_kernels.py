"""
Kernels of your own array
=========================

A *kernel* is the pattern of currents that reaches one class of afferents under one electrode and
the others as little as can be. It is the optimum of a linear program, and follows from where the
electrodes lie and from the skin below them.
"""

import matplotlib.pyplot as plt

import smarttouch as st
from smarttouch.lab import kernel_figure

# %%
# The 4 x 4 electrodes of the paper's SmartTouch, one kernel of each class near the middle. Left
# the currents, right what they do at the depth of each class, of what they do at the target (+).
# RA and SAI can be reached almost alone. PC cannot: it lies deepest.
profile = st.load_profile("smarttouch-4x4")
kernels = {each: st.design_kernel(profile, each, 5) for each in st.Afferent}
for each, kernel in kernels.items():
    print(f"{each.name}: {kernel.off_target:.3g} of the target at {kernel.off_target_class.name}")
kernel_figure(profile, kernels, 5)

# %%
# Denser or coarser? The same skin under arrays of another pitch. A copy is checked as a file is.
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
axes.set(xlabel="pitch (mm)", ylabel="largest activation of another class")
axes.legend(frameon=False)
plt.show()
