"""The figures of the paper's Section II, redrawn from its equations."""

from typing import TYPE_CHECKING, Any

import numpy as np

from smarttouch.afferent import CLASS_COLORS, Afferent
from smarttouch.kernels.design import design_kernel
from smarttouch.kernels.problem import Array, Problem
from smarttouch.physiology.activation import field
from smarttouch.physiology.afferents import depth_mm
from smarttouch.physiology.potential import line_in_plane
from smarttouch.plotting.style import (
    ANODIC,
    CATHODIC,
    GREY,
    SIGNED_MAP,
    new_figure,
    plain,
)
from smarttouch.profile import Profile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ACROSS_MM = np.linspace(-4, 4, 321)
_DEPTHS_MM = np.linspace(0.1, 3.0, 146)
_CENTER = 3
_ALONE = np.array([0.0, 0, 0, 1, 0, 0, 0])
_NARROWED = np.array([0, 0, -0.5, 1, -0.5, 0, 0])
_BROADENED = np.array([-1.5, 0, 1, 1, 1, 0, -1.5]) / 3


def figure_5(line: Profile) -> "Figure":
    """Draw the AF of a horizontal axon under one cathodic line electrode (Eq. 5)."""
    figure = new_figure(5.0, 3.0)
    axes = figure.subplots()
    highest = float(line_in_plane(np.zeros(1), line.skin.ra_depth_mm).xx[0])
    for afferent in Afferent:
        depth = depth_mm(line.skin, afferent)
        af = line_in_plane(_ACROSS_MM, depth).xx / highest
        axes.plot(_ACROSS_MM, af, color=CLASS_COLORS[afferent], label=f"{depth:g} mm deep")
    axes.axhline(0, color=GREY, lw=0.6)
    axes.legend(frameon=False, fontsize=8)
    plain(
        axes,
        "Horizontal axon under one cathodic line electrode (Fig. 5)",
        "place along the axon (mm)",
        f"activating function,\nof the largest at {line.skin.ra_depth_mm:g} mm",
    )
    return figure


def figure_8(line: Profile) -> "Figure":
    """Draw the optimal weights of the three modes on the paper's array."""
    figure = new_figure(7.5, 2.6)
    for axes, afferent in zip(
        figure.subplots(1, 3, sharey=True), (Afferent.SAI, Afferent.PC, Afferent.RA), strict=True
    ):
        kernel = design_kernel(Problem(line, afferent), _CENTER)
        draw_weights(axes, line, kernel.peak_normalized)
        plain(
            axes,
            f"{afferent.name} mode: worst other {kernel.off_target:.3g}",
            "electrode (mm)",
            "weight, cathodic up" if afferent is Afferent.SAI else "",
        )
    return figure


def figure_9(line: Profile) -> "Figure":
    """Draw depth-selective stimulation: anodes, then cathodes, beside a cathode."""
    figure = new_figure(7.5, 5.2)
    panels = figure.subplots(2, 2, width_ratios=[1.6, 1])
    cases = (
        (_NARROWED, "(a) anodes around the cathode: shallow"),
        (_BROADENED, "(b) cathodes around the cathode: deep"),
    )
    for (left, right), (weights, title) in zip(panels, cases, strict=True):
        drawn = _draw_depth_map(left, line, weights, rising=False)
        plain(left, title, "place along the axon (mm)", "depth (mm)")
        for pattern, style in ((weights, "-"), (_ALONE, ":")):
            depths = np.linspace(0.8, 3.0, 111)
            below = _af(line, pattern, np.zeros(1), depths, rising=False)[:, 0]
            right.plot(
                below / below[np.abs(depths - line.skin.sai_depth_mm).argmin()],
                depths,
                style,
                color=CATHODIC if style == "-" else GREY,
                label="this pattern" if style == "-" else "the cathode alone",
            )
        right.set(xlim=(0, 1.3), ylim=(3.0, 0.8))
        for afferent in (Afferent.SAI, Afferent.PC):
            depth = depth_mm(line.skin, afferent)
            right.axhline(depth, color=CLASS_COLORS[afferent], lw=0.8)
            right.text(1.29, depth + 0.03, afferent.name, fontsize=7, ha="right", va="top")
        right.legend(frameon=False, fontsize=7, loc="lower right")
        plain(right, "under the middle", "AF, relative to that at SAI depth", "depth (mm)")
    _add_scale(figure, drawn, panels)
    return figure


def figure_10(line: Profile) -> "Figure":
    """Draw orientation-selective stimulation: a cathode and an anode, both kinds of axon."""
    figure = new_figure(7.5, 5.2)
    panels = figure.subplots(2, 2)
    for row, (weights, name) in zip(
        panels, ((_ALONE, "(a) cathode"), (-_ALONE, "(b) anode")), strict=True
    ):
        for axes, rising in zip(row, (False, True), strict=True):
            drawn = _draw_depth_map(axes, line, weights, rising)
            axons = "rising axons (RA)" if rising else "horizontal axons (SAI, PC)"
            plain(axes, f"{name}, {axons}", "place (mm)", "depth (mm)")
    _add_scale(figure, drawn, panels)
    return figure


def draw_weights(axes: Any, line: Profile, weights: Array) -> None:
    """Draw weights of line electrodes as the paper's bars, cathodic up."""
    place = line.electrodes.position_mm[:, 0]
    colors = [CATHODIC if weight > 0 else ANODIC for weight in weights]
    axes.bar(place, weights, width=0.5 * line.electrodes.pitch_mm, color=colors)
    axes.axhline(0, color=GREY, lw=0.6)
    axes.set(ylim=(-1.1, 1.1), xticks=place)


def _af(profile: Profile, weights: Array, x: Array, depths: Array, rising: bool) -> Array:
    """Return the AF of a pattern over places and depths, (D, X)."""
    direction = np.array([0.0, 0, 1]) if rising else np.array([1.0, 0, 0])
    places = np.column_stack([x, np.zeros_like(x)])
    rows = []
    for depth in depths:
        found, _ = field(profile.electrodes, profile.skin, places, float(depth))
        rows.append(found.along(direction) @ weights)
    return np.array(rows)


def _draw_depth_map(axes: Any, line: Profile, weights: Array, rising: bool) -> Any:
    af = _af(line, weights, _ACROSS_MM, _DEPTHS_MM, rising)
    af /= np.abs(af[_DEPTHS_MM >= 0.3]).max()
    # Cube roots show both the strong AF under the electrode and the weak one in the deep.
    drawn = draw_field(axes, _ACROSS_MM, _DEPTHS_MM, np.cbrt(af))
    axes.contour(_ACROSS_MM, _DEPTHS_MM, af, levels=[0], colors=GREY, linewidths=0.6)
    for place, weight in zip(line.electrodes.position_mm[:, 0], weights, strict=True):
        if weight:
            color = CATHODIC if weight > 0 else ANODIC
            axes.plot(
                [place - 0.25, place + 0.25],
                [0, 0],
                color=color,
                lw=9,
                clip_on=False,
                solid_capstyle="butt",
            )
            label = f"{weight:+.2g}".replace("-", "−").replace("0.", ".")
            axes.text(place, 0, label, ha="center", va="center", fontsize=6, color="white")
    axes.set(ylim=(_DEPTHS_MM[-1], 0), xlim=(-4, 4))
    axes.spines["bottom"].set_visible(False)
    return drawn


def draw_field(axes: Any, x: Array, y: Array, af: Array) -> Any:
    """Draw a field over evenly spaced places, (Y, X), as an image: far sooner than as a mesh."""
    half_x, half_y = (x[1] - x[0]) / 2, (y[1] - y[0]) / 2
    return axes.imshow(
        af,
        cmap=SIGNED_MAP,
        vmin=-1,
        vmax=1,
        extent=(x[0] - half_x, x[-1] + half_x, y[-1] + half_y, y[0] - half_y),
        origin="upper",
        interpolation="bilinear",
        aspect=axes.get_aspect(),
    )


def _add_scale(figure: "Figure", drawn: Any, panels: Any) -> None:
    bar = figure.colorbar(drawn, ax=panels, ticks=np.cbrt([-1, -0.1, -0.01, 0, 0.01, 0.1, 1]))
    bar.ax.set_yticklabels(["−1", "−.1", "−.01", "0", ".01", ".1", "1"], fontsize=7)
    bar.set_label("activating function, depolarizing above 0", fontsize=8)
