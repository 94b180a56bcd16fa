"""
A letter on one finger
======================

Afferents lie under the electrodes, at random places in each simulated finger. What a finger feels
depends on which afferents fire and on where their receptors are.
"""

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import CLASS_COLORS

profile = st.load_profile("electric-mouse")
finger = st.Finger(profile, seed=1, anatomy="paper")
print(f"{len(finger.classes)} afferents")

# %%
# Make the steps of a run without a board, and compute the finger's response to the strongest step.
steps = list(st.steps(st.open_source("text:T", profile, speed_mm_s=40), profile, seconds=2))
strongest = max(steps, key=lambda step: np.abs(step.sequence.current_ua).sum(dtype=int))
feeling = finger.feel(strongest)
for name, count in feeling.quality.afferents.items():
    print(f"{name.name}: {count} fired")
print(f"silent points: {feeling.quality.silent_points:.2f}")

# %%
# Draw the electrodes (active ones in gray) and the receptors of the afferents that fired.
figure, axes = plt.subplots(figsize=(5, 5), layout="constrained")
axes.scatter(*profile.electrodes.position_mm.T, s=120, c="white", edgecolors="#707070")
axes.scatter(*profile.electrodes.position_mm[feeling.active].T, s=120, c="#c8c8c8")
for afferent, color in CLASS_COLORS.items():
    fired = (finger.classes == afferent) & (feeling.counts > 0)
    axes.scatter(*finger.receptor_mm[fired].T, s=12, c=color, label=afferent.name)
axes.set(xlabel="x (mm)", ylabel="y (mm), palm below", aspect="equal")
axes.invert_yaxis()
axes.legend()
plt.show()
