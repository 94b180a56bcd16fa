"""
Strength and duration
=====================

How does the threshold of a fiber depend on pulse width? In a cable model with active membrane it
follows Weiss's law, with a rheobase and a chronaxie. The activating function cannot predict this,
because it does not depend on time.
"""

import matplotlib.pyplot as plt
import numpy as np
from studies.af_error import potential_at_nodes

import smarttouch as st
from smarttouch.lab import ANODIC, CATHODIC, Fiber, threshold_ma, weiss_fit

# %%
# Compute thresholds of a flat fiber 0.9 mm below a disc of 1.0 mm (SAI), for five widths and both
# polarities, and fit Weiss's law.
profile = st.load_profile("electric-mouse")
widths_us = np.array([20.0, 35.0, 60.0, 100.0, 200.0])
fiber = Fiber(end="through")
potential = potential_at_nodes(profile, fiber, profile.skin.sai_depth_mm)

figure, axes = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
for name, cathodic, color in (("cathodic", True, CATHODIC), ("anodic", False, ANODIC)):
    fires_ma = [threshold_ma(potential, fiber, each, cathodic=cathodic) for each in widths_us]
    rheobase_ma, chronaxie_us = weiss_fit(widths_us, fires_ma)
    print(f"{name}: rheobase {rheobase_ma:.2f} mA, chronaxie {chronaxie_us:.0f} µs")
    axes.plot(widths_us, fires_ma, "o", color=color, label=f"{name}, cable model")
    dense_us = np.linspace(18, 210, 100)
    axes.plot(
        dense_us, rheobase_ma * (1 + chronaxie_us / dense_us), color=color, label="Weiss's law"
    )
axes.axhline(profile.limits.current_ma, color="#707070", ls=":", label="limit of the profile")
axes.set(xlabel="pulse width (µs)", ylabel="threshold (mA)", yscale="log")
axes.set_yticks([2, 5, 10], ["2", "5", "10"])
axes.minorticks_off()
axes.legend(frameon=False, fontsize=8)
plt.show()
