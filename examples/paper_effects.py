"""
The paper's effects on simulated fingers
========================================

Four effects from Sections III-B and III-C of the paper: the order of sensations, the blur below a
cathode, the shift of PC, and the concentric electrode. Two effects depend on our assumptions. PC
fires after SAI and before RA because we doubled the threshold of PC; otherwise PC would fire first.
The shift depends on the length of PC axons. ``studies/effects_on_fingers.py`` prints the numbers.
"""

import matplotlib.pyplot as plt
import numpy as np
from studies import effects_on_fingers

import smarttouch as st
from smarttouch.lab import ANODIC, CATHODIC, CLASS_COLORS, electrode_patches

profile = st.load_profile("electric-mouse")
sites = effects_on_fingers.inner_sites(profile)
fingers = [st.Finger(profile, seed, "paper") for seed in range(1, 9)]

# %%
# SAI mode on line electrodes, with rising current: first pressure, then vibration, as in Section
# III-B.1. The paper reports pressure at 0.4 mA and vibration at 0.6 mA. Simulated fingers need
# about 15 times as much.
_, order = plt.subplots(figsize=(5, 4.5), layout="constrained")
stages = effects_on_fingers.stages("paper", range(1, 8))
least_ma = min(current_ma[0] for current_ma in stages.values())
for afferent, current_ma in stages.items():
    order.step(current_ma / least_ma, np.arange(1, 11), where="post",
               color=CLASS_COLORS[afferent], label=afferent.name)  # fmt: skip
    print(f"{afferent.name} first fires at {current_ma[0] / least_ma:.1f} times the lowest current")
order.set(xlim=(0.8, 4), xlabel="current / lowest threshold", ylabel="afferents that fire",
          title="SAI mode: pressure, then vibration")  # fmt: skip
order.legend()
plt.show()

# %%
# Draw the receptors of the axons that one electrode fires, relative to this electrode (Fig. 15).
# A cathode also fires axons that only pass below it, whose receptors are farther away.
_, blur = plt.subplots(figsize=(5, 4.5), layout="constrained")
for cathodic, color in ((True, CATHODIC), (False, ANODIC)):
    current_ma = 2.4 * effects_on_fingers.against_all(profile, cathodic)
    away = [
        finger.receptor_mm[who] - profile.electrodes.position_mm[site]
        for finger in fingers
        for site, who in zip(
            sites, effects_on_fingers.fired(finger, current_ma[sites]).T, strict=True
        )
    ]
    name = "cathodic" if cathodic else "anodic"
    blur.scatter(*np.concatenate(away).T, s=8, color=color, label=name)
    found = effects_on_fingers.shift(fingers, current_ma, sites, list(st.Afferent))
    print(f"{name}: receptors {found.away_mm:.1f} mm (RMS) from the electrode")
blur.set(
    xlabel="x (mm)", ylabel="y (mm), palm below", aspect="equal", title="One electrode, 2.4 mA"
)
blur.invert_yaxis()
blur.legend()
plt.show()

# %%
# In PC mode, the receptors of the PC axons that fire lie toward the fingertip (Section III-B.4).
# Gray: the shift of 1 to 3 mm in the paper. Black: the mean of the simulated fingers.
_, shifted = plt.subplots(figsize=(5, 4.5), layout="constrained")
current_ma = 2.4 * effects_on_fingers.kernel_ma(profile, st.load_kernels(profile), st.Afferent.PC)
found = effects_on_fingers.shift(fingers, current_ma, sites, [st.Afferent.PC])
toward_mm = [
    profile.electrodes.position_mm[site, 1] - finger.receptor_mm[who & (finger.classes == 2), 1]
    for finger in fingers
    for site, who in zip(sites, effects_on_fingers.fired(finger, current_ma[sites]).T, strict=True)
]
shifted.hist(np.concatenate(toward_mm), bins=np.arange(-4, 10), color=CLASS_COLORS[st.Afferent.PC])
shifted.axvspan(1, 3, color="0.9", zorder=0)
shifted.axvline(-found.y_mm, color="black")
shifted.set(xlabel="toward the fingertip (mm)", ylabel="afferents", title="PC mode: receptors")
plt.show()
print(f"PC receptors lie on average {-found.y_mm:.1f} mm toward the fingertip")

# %%
# Draw the afferents that fire under the concentric electrode of Section III-C, which is an anodic
# disc in a ring.
_, ring = plt.subplots(figsize=(5, 4.5), layout="constrained")
electrode = st.load_profile("concentric")
finger = st.Finger(electrode, 4, "paper")
fires = effects_on_fingers.fired(finger, np.array([[-2.4, 2.4]]))[:, 0]
for patch in electrode_patches(electrode):
    patch.set(facecolor="0.85", edgecolor="0.4")
    ring.add_patch(patch)
for afferent, color in CLASS_COLORS.items():
    mine = finger.classes == afferent
    ring.scatter(*finger.receptor_mm[mine].T, s=6, color=color, alpha=0.25)
    ring.scatter(*finger.receptor_mm[mine & fires].T, s=30, color=color, label=afferent.name)
    print(f"{afferent.name}: {np.sum(mine & fires)} afferents fire")
ring.set(xlim=(-4.5, 4.5), ylim=(4.5, -4.5), aspect="equal", title="Disc of 1 mm in a ring, anodic")
ring.legend()
plt.show()
