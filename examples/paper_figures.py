"""
The paper's figures, redrawn
============================

Figures 5, 8, 9 and 10 of Kajimoto, Kawakami and Tachi, from its equations on its line array: what a
line electrode does to an axon, and which patterns of currents choose between axons by their depth
and by their direction.
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
# The activating function (AF) of a horizontal axon under one cathodic line electrode (Eq. 5). It
# depolarizes the axon under the electrode, less the deeper the axon lies.
highest = float(line_in_plane(np.zeros(1), line.skin.ra_depth_mm).xx[0])
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for afferent in st.Afferent:
    depth = depth_mm(line.skin, afferent)
    af = line_in_plane(across_mm, depth).xx / highest
    axes.plot(across_mm, af, color=CLASS_COLORS[afferent], label=f"{depth:g} mm deep")
axes.axhline(0, color=GREY, lw=0.6)
axes.legend(frameon=False, fontsize=8)
axes.set(xlabel="place along the axon (mm)", title="Fig. 5",
         ylabel=f"AF, of the largest at {line.skin.ra_depth_mm:g} mm")  # fmt: skip
plt.show()

# %%
# The optimal weights of the three modes, cathodic up (Fig. 8), by the paper's programme alone, with
# no bound on the own class beside the target. The ratios are ours; the paper prints none.
figure, panels = plt.subplots(1, 3, figsize=(7.5, 2.6), sharey=True, layout="constrained")
for axes, afferent in zip(panels, ("SAI", "PC", "RA"), strict=True):
    kernel = st.design_kernel(line, afferent, center, model="paper")
    draw_weights(axes, line, kernel.peak_normalized)
    axes.set(xlabel="electrode (mm)", title=f"{afferent}: worst other {kernel.off_target:.3g}")
    print(f"{afferent} mode: {np.round(kernel.peak_normalized, 2).tolist()}")
panels[0].set_ylabel("weight, cathodic up")
plt.show()


# %%
# Depth: anodes around the cathode leave less for the deep axons, cathodes around it more (Fig. 9).
# The weights are chosen by hand to show it, as the paper prints none for this figure.
def af_of(weights, x_mm, depths, rising):
    """Return the AF of a pattern over depths and places, (D, X)."""
    direction = np.array([0.0, 0, 1]) if rising else np.array([1.0, 0, 0])
    places = np.column_stack([x_mm, np.zeros_like(x_mm)])
    fields = (field_at(line.electrodes, line.skin, places, float(each))[0] for each in depths)
    return np.array([found.along(direction) @ weights for found in fields])


def draw_depths(axes, weights, rising, title):
    """Draw the AF over place and depth, and the electrodes above it."""
    af = af_of(weights, across_mm, depths_mm, rising)
    af /= np.abs(af[depths_mm >= 0.3]).max()
    # Cube roots show both the strong AF under the electrode and the weak one in the deep.
    drawn = draw_field(axes, across_mm, depths_mm, np.cbrt(af))
    axes.contour(across_mm, depths_mm, af, levels=[0], colors=GREY, linewidths=0.6)
    for place, weight in zip(line.electrodes.position_mm[:, 0], weights, strict=True):
        if weight:
            axes.plot([place - 0.25, place + 0.25], [0, 0], lw=9, clip_on=False,
                      color=CATHODIC if weight > 0 else ANODIC, solid_capstyle="butt")  # fmt: skip
            label = f"{weight:+.2g}".replace("-", "−").replace("0.", ".")
            axes.text(place, 0, label, ha="center", va="center", fontsize=6, color="white")
    axes.set(ylim=(depths_mm[-1], 0), xlim=(-4, 4), ylabel="depth (mm)",
             xlabel="place (mm)", aspect="auto")  # fmt: skip
    axes.set_title(title, fontsize=9, pad=9)
    return drawn


def add_scale(figure, drawn, panels):
    """Add the scale of the colors, whose cube roots are drawn."""
    bar = figure.colorbar(drawn, ax=panels, ticks=np.cbrt([-1, -0.1, -0.01, 0, 0.01, 0.1, 1]))
    bar.ax.set_yticklabels(["−1", "−.1", "−.01", "0", ".01", ".1", "1"], fontsize=7)
    bar.set_label("AF, depolarizing above 0", fontsize=8)


alone = np.array([0.0, 0, 0, 1, 0, 0, 0])
patterns = {
    "(a) anodes around the cathode: shallow": np.array([0, 0, -0.5, 1, -0.5, 0, 0]),
    "(b) cathodes around the cathode: deep": np.array([-1.5, 0, 1, 1, 1, 0, -1.5]) / 3,
}
figure, panels = plt.subplots(2, 2, figsize=(7.5, 5.2), width_ratios=[1.6, 1], layout="constrained")
below_mm = np.linspace(0.8, 3.0, 111)
for (left, right), (title, weights) in zip(panels, patterns.items(), strict=True):
    drawn = draw_depths(left, weights, False, title)
    for pattern, style, color in ((weights, "-", CATHODIC), (alone, ":", GREY)):
        below = af_of(pattern, np.zeros(1), below_mm, False)[:, 0]
        below /= below[np.abs(below_mm - line.skin.sai_depth_mm).argmin()]
        name = "this pattern" if style == "-" else "the cathode alone"
        right.plot(below, below_mm, style, color=color, label=name)
    for afferent in (st.Afferent.SAI, st.Afferent.PC):
        depth = depth_mm(line.skin, afferent)
        right.axhline(depth, color=CLASS_COLORS[afferent], lw=0.8)
        right.text(1.29, depth + 0.03, afferent.name, fontsize=7, ha="right", va="top")
    right.set(xlim=(0, 1.3), ylim=(3.0, 0.8), title="under the middle", ylabel="depth (mm)",
              xlabel="AF, relative to that at SAI depth")  # fmt: skip
    right.legend(frameon=False, fontsize=7, loc="lower right")
add_scale(figure, drawn, panels)
plt.show()

# %%
# Direction: a cathode depolarizes horizontal axons, an anode rising ones (Fig. 10). Under lines the
# two are opposite and equal; under discs, with two horizontal directions, a rising axon gets minus
# the sum of both: right under a disc twice as much.
figure, panels = plt.subplots(2, 2, figsize=(7.5, 5.2), layout="constrained")
for row, (weights, name) in zip(
    panels, ((alone, "(a) cathode"), (-alone, "(b) anode")), strict=True
):
    for axes, rising in zip(row, (False, True), strict=True):
        axons = "rising axons (RA)" if rising else "horizontal axons (SAI, PC)"
        drawn = draw_depths(axes, weights, rising, f"{name}, {axons}")
add_scale(figure, drawn, panels)
plt.show()
