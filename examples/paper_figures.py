"""
The paper's figures, redrawn
============================

Figures 5, 8, 9 and 10 of Kajimoto, Kawakami and Tachi, computed from the paper's equations for its
line array. They show what a line electrode does to an axon, and how patterns of currents select
axons by depth and by direction.
"""

import matplotlib.pyplot as plt
import numpy as np

import smarttouch as st
from smarttouch.lab import (
    ANODIC,
    CATHODIC,
    CLASS_COLORS,
    GREY,
    depth_mm,
    draw_field,
    draw_weights,
    field_at,
    line_in_plane,
)

line = st.load_profile("line-7")
center = 3
across_mm, depths_mm = np.linspace(-4, 4, 321), np.linspace(0.1, 3.0, 146)

# %%
# The activating function (AF) of a horizontal axon under one cathodic line electrode (Eq. 5). Under
# the electrode the AF is positive, so it depolarizes the axon. It is smaller for deeper axons.
highest = float(line_in_plane(np.zeros(1), line.skin.ra_depth_mm).xx[0])
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for afferent in st.Afferent:
    depth = depth_mm(line.skin, afferent)
    af = line_in_plane(across_mm, depth).xx / highest
    axes.plot(across_mm, af, color=CLASS_COLORS[afferent], label=f"{depth:g} mm deep")
axes.axhline(0, color=GREY, lw=0.6)
axes.legend(frameon=False, fontsize=8)
axes.set(xlabel="position along the axon (mm)", title="Fig. 5",
         ylabel=f"AF / largest AF at {line.skin.ra_depth_mm:g} mm")  # fmt: skip
plt.show()

# %%
# The optimal weights of the three modes (Fig. 8), by the paper's linear program. It does not limit
# spill, the activation of the same class farther away. The titles show our off-target values; the
# paper does not print any.
figure, panels = plt.subplots(1, 3, figsize=(7.5, 2.6), sharey=True, layout="constrained")
for axes, afferent in zip(panels, ("SAI", "PC", "RA"), strict=True):
    kernel = st.design_kernel(line, afferent, center, model="paper")
    draw_weights(axes, line, kernel.peak_normalized)
    axes.set(xlabel="electrode (mm)", title=f"{afferent}: off-target {kernel.off_target:.3g}")
    print(f"{afferent} mode: {np.round(kernel.peak_normalized, 2).tolist()}")
panels[0].set_ylabel("weight, cathodic up")
plt.show()


# %%
# Selection by depth (Fig. 9): anodes beside the cathode weaken the AF of deep axons, and cathodes
# beside it strengthen this AF. We chose the weights, because the paper does not print them.
def af_of(weights, x_mm, depths, vertical):
    """Return the AF of a pattern at each depth and each position along x, (D, X)."""
    direction = np.array([0.0, 0, 1]) if vertical else np.array([1.0, 0, 0])
    places = np.column_stack([x_mm, np.zeros_like(x_mm)])
    fields = (field_at(line.electrodes, line.skin, places, float(each))[0] for each in depths)
    return np.array([found.along(direction) @ weights for found in fields])


def draw_depths(axes, weights, vertical, title):
    """Draw the AF over x and depth, with the electrodes and their weights at the top."""
    af = af_of(weights, across_mm, depths_mm, vertical)
    af /= np.abs(af[depths_mm >= 0.3]).max()
    # Draw cube roots, so that the strong AF under the electrode and the weak AF below are visible.
    drawn = draw_field(axes, across_mm, depths_mm, np.cbrt(af))
    axes.contour(across_mm, depths_mm, af, levels=[0], colors=GREY, linewidths=0.6)
    for place, weight in zip(line.electrodes.position_mm[:, 0], weights, strict=True):
        if weight:
            axes.plot([place - 0.25, place + 0.25], [0, 0], lw=9, clip_on=False,
                      color=CATHODIC if weight > 0 else ANODIC, solid_capstyle="butt")  # fmt: skip
            label = f"{weight:+.2g}".replace("-", "−").replace("0.", ".")
            axes.text(place, 0, label, ha="center", va="center", fontsize=6, color="white")
    axes.set(ylim=(depths_mm[-1], 0), xlim=(-4, 4), ylabel="depth (mm)",
             xlabel="x (mm)", aspect="auto")  # fmt: skip
    axes.set_title(title, fontsize=9, pad=9)
    return drawn


def add_scale(figure, drawn, panels):
    """Add a color scale. Colors show the cube root of the AF; labels state the AF itself."""
    bar = figure.colorbar(drawn, ax=panels, ticks=np.cbrt([-1, -0.1, -0.01, 0, 0.01, 0.1, 1]))
    bar.ax.set_yticklabels(["−1", "−.1", "−.01", "0", ".01", ".1", "1"], fontsize=7)
    bar.set_label("AF (above 0: depolarizing)", fontsize=8)


alone = np.array([0.0, 0, 0, 1, 0, 0, 0])
patterns = {
    "(a) anodes beside the cathode: shallow": np.array([0, 0, -0.5, 1, -0.5, 0, 0]),
    "(b) cathodes beside the cathode: deep": np.array([-1.5, 0, 1, 1, 1, 0, -1.5]) / 3,
}
figure, panels = plt.subplots(2, 2, figsize=(7.5, 5.2), width_ratios=[1.6, 1], layout="constrained")
below_mm = np.linspace(0.8, 3.0, 111)
for (left, right), (title, weights) in zip(panels, patterns.items(), strict=True):
    drawn = draw_depths(left, weights, False, title)
    for pattern, style, color in ((weights, "-", CATHODIC), (alone, ":", GREY)):
        below = af_of(pattern, np.zeros(1), below_mm, False)[:, 0]
        below /= below[np.abs(below_mm - line.skin.sai_depth_mm).argmin()]
        name = "this pattern" if style == "-" else "only the cathode"
        right.plot(below, below_mm, style, color=color, label=name)
    for afferent in (st.Afferent.SAI, st.Afferent.PC):
        depth = depth_mm(line.skin, afferent)
        right.axhline(depth, color=CLASS_COLORS[afferent], lw=0.8)
        right.text(1.29, depth + 0.03, afferent.name, fontsize=7, ha="right", va="top")
    right.set(xlim=(0, 1.3), ylim=(3.0, 0.8), title="below the middle", ylabel="depth (mm)",
              xlabel="AF / AF at the depth of SAI")  # fmt: skip
    right.legend(frameon=False, fontsize=7, loc="lower right")
add_scale(figure, drawn, panels)
plt.show()

# %%
# Selection by direction (Fig. 10): a cathode depolarizes horizontal axons, an anode vertical axons.
# Under a line electrode, the AFs of vertical and horizontal axons have equal size and opposite
# signs. Right under a disc, the AF of vertical axons is twice as large as that of horizontal axons,
# because the AFs along x, y and z add up to zero.
figure, panels = plt.subplots(2, 2, figsize=(7.5, 5.2), layout="constrained")
for row, (weights, name) in zip(
    panels, ((alone, "(a) cathode"), (-alone, "(b) anode")), strict=True
):
    for axes, vertical in zip(row, (False, True), strict=True):
        axons = "vertical axons (RA)" if vertical else "horizontal axons (SAI, PC)"
        drawn = draw_depths(axes, weights, vertical, f"{name}, {axons}")
add_scale(figure, drawn, panels)
plt.show()
