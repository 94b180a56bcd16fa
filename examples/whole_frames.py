"""
Whole frames: many points in one slot
=====================================

Points are usually scanned one by one, because their currents interfere. Interference is linear
and known, so it can be designed away: then several points share one slot, and the same frame
takes a third or a quarter of the time.
"""

import matplotlib.pyplot as plt
from studies.slot_figures import frame_figure

import smarttouch as st

# %%
# A letter of 12 points in 3 slots: the currents of each, and below what they do to RA. Last row:
# four RA and four SAI points in one slot, each the other's return.
profile = st.load_profile("electric-mouse")
kernels = st.load_kernels(profile)
frame_figure(profile, kernels)

# %%
# A run takes this by its setting ``scan``. Each sequence comes with a proof of its shared slots.
slots = {}
for scan in ("points", "auto", "frame"):
    source = st.open_source("text:H", profile, speed_mm_s=100)
    steps = list(st.steps(source, profile, mode="RA", kernels=kernels, scan=scan))
    slots[scan] = sum(step.sequence.slots for step in steps)
    shared = [
        found for step in steps if step.sequence.proof and (found := step.sequence.proof.shared)
    ]
    if shared:
        worst, spill = (max(each) for each in zip(*shared, strict=True))
        print(f"{scan}: worst other {worst:.2f}, spill {spill:.2f} of the weakest target")

figure, axes = plt.subplots(figsize=(5, 2.2), layout="constrained")
axes.barh(list(slots), list(slots.values()), color="#0072b2")
axes.set(xlabel="slots for the whole pass")
axes.invert_yaxis()
plt.show()
