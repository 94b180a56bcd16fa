"""Figures of kernels."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.kernels.design_problem import Array, Kernel
from smarttouch.physiology.activating_function import depth_mm, directions, field_at
from smarttouch.profile import Profile
from smarttouch.views.figure_style import ANODIC, CATHODIC, GREY, SIGNED_MAP, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 121


def kernel_figure(profile: Profile, kernels: Mapping[Afferent, Kernel], site: int) -> "Figure":
    """Draw the kernels of one site, one per row, with their activation relative to the target."""
    if profile.skin.medium == "plane":
        return _line_figure(profile, kernels)
    width, height = _reach_mm(profile) * 2
    tall = min(2.4, max(1.4, 1.9 * height / width))
    figure = new_figure(8.6, 0.35 + len(kernels) * (tall + 0.35))
    panels = figure.subplots(len(kernels), 4, squeeze=False, sharex=True, sharey=True)
    x, y = (np.linspace(-reach_mm, reach_mm, _POINTS) for reach_mm in _reach_mm(profile))
    per_ma = _per_ma(profile, np.stack(np.meshgrid(x, y), axis=-1))
    for row, (afferent, kernel) in zip(panels, kernels.items(), strict=True):
        weights_drawn = draw_electrodes(row[0], profile, cmap=SIGNED_MAP, clim=(-1, 1))
        weights_drawn.set_array(kernel.peak_normalized)
        worst = f"off-target {kernel.off_target:.2g} ({kernel.off_target_class.name})"
        plain(row[0], f"{afferent.name} kernel\n{worst}", "", "y (mm)")
        for axes, shown in zip(row[1:], Afferent, strict=True):
            drawn = draw_field(axes, x, y, _activation(per_ma[shown], kernel))
            plain(axes, f"at {shown.name}, {depth_mm(profile.skin, shown):g} mm deep")
            draw_electrodes(axes, profile, facecolor="none")
            axes.plot(*profile.electrodes.position_mm[site], "+", color="black", ms=7)
    for axes in panels[-1]:
        axes.set_xlabel("x (mm)", fontsize=8)
    weights_bar = figure.colorbar(
        weights_drawn, ax=panels[:, 0], orientation="horizontal", aspect=12
    )
    weights_bar.set_label("weight, cathodic > 0", fontsize=8)
    bar = figure.colorbar(
        drawn, ax=panels[:, 1:], orientation="horizontal", aspect=40, extend="both"
    )
    bar.set_label("activating function relative to the target (strongest direction)", fontsize=8)
    for axis_bar in (weights_bar, bar):
        axis_bar.ax.tick_params(labelsize=7)
    return figure


def _line_figure(profile: Profile, kernels: Mapping[Afferent, Kernel]) -> "Figure":
    figure = new_figure(7.5, 0.3 + 2.2 * len(kernels))
    panels = figure.subplots(len(kernels), 2, squeeze=False)
    x = np.linspace(-1, 1, 4 * _POINTS) * _reach_mm(profile)[0]
    per_ma = _per_ma(profile, np.column_stack([x, np.zeros_like(x)]))
    for (left, right), (afferent, kernel) in zip(panels, kernels.items(), strict=True):
        draw_weights(left, profile, kernel.peak_normalized)
        plain(left, f"{afferent.name} kernel", "electrode (mm)", "weight, cathodic up")
        for shown in Afferent:
            af = _activation(per_ma[shown], kernel)
            right.plot(x, af, color=CLASS_COLORS[shown], label=shown.name)
        right.axhline(0, color=GREY, lw=0.6)
        right.axhline(1, color=GREY, lw=0.6, ls=":", label="target")
        right.set_ylim(-2.2, max(1.4, 1.1 * kernel.off_target))
        if afferent is next(iter(kernels)):
            right.legend(frameon=False, fontsize=7, ncols=2)
        plain(
            right,
            f"off-target {kernel.off_target:.4g} ({kernel.off_target_class.name})",
            "position (mm)",
            "AF relative to the target",
        )
    return figure


def _reach_mm(profile: Profile) -> Array:
    array = profile.electrodes
    return np.asarray(np.abs(array.position_mm).max(axis=0) + array.pitch_mm)


def _per_ma(profile: Profile, places: Array) -> dict[Afferent, Array]:
    """For each class, return an array (D, ..., E) for D fiber directions and E electrodes. It holds
    the activating function at ``places``, (..., 2), if 1 mA flows through that electrode alone."""
    skin = profile.skin
    per_ma = {}
    for shown in Afferent:
        fields, scale = field_at(
            profile.electrodes, skin, places.reshape(-1, 2), depth_mm(skin, shown)
        )
        along = scale * np.array([fields.along(direction) for direction in directions(skin, shown)])
        per_ma[shown] = along.reshape(len(along), *places.shape[:-1], -1)
    return per_ma


def _activation(per_ma: Array, kernel: Kernel) -> Array:
    """Return a kernel's activating function at each place: its largest value in any direction."""
    return np.asarray((per_ma @ kernel.weights).max(axis=0))


def draw_electrodes(axes: Any, profile: Profile, **style: Any) -> Any:
    """Draw all electrodes to scale, with axes that show the whole array; return the patches."""
    from matplotlib.collections import PatchCollection

    drawn = PatchCollection(electrode_patches(profile), edgecolor=GREY, linewidth=0.3, **style)
    axes.add_collection(drawn)
    reach = _reach_mm(profile)
    axes.set(xlim=(-reach[0], reach[0]), ylim=(reach[1], -reach[1]), aspect="equal")
    return drawn


def electrode_patches(profile: Profile) -> list[Any]:
    """Return a Matplotlib patch for each electrode, to scale."""
    from matplotlib.patches import Annulus, Circle, Rectangle

    array = profile.electrodes
    patches: list[Any] = [None] * len(array)
    for (shape, (first, second)), which in array.kinds.items():
        for index in which:
            x, y = array.position_mm[index]
            if shape == "rectangle":
                patches[index] = Rectangle((x - first / 2, y - second / 2), first, second)
            elif shape == "annulus":
                patches[index] = Annulus((x, y), first / 2, (first - second) / 2)
            else:
                radius = first / 2 if shape == "disc" else 0.1 * array.pitch_mm
                patches[index] = Circle((x, y), radius)
    return patches


def draw_weights(axes: Any, line: Profile, weights: Array) -> None:
    """Draw the weights of a line of electrodes as bars, cathodic upward, as in the paper."""
    x_mm = line.electrodes.position_mm[:, 0]
    colors = [CATHODIC if weight > 0 else ANODIC for weight in weights]
    axes.bar(x_mm, weights, width=0.5 * line.electrodes.pitch_mm, color=colors)
    axes.axhline(0, color=GREY, lw=0.6)
    axes.set(ylim=(-1.1, 1.1), xticks=x_mm)


def draw_field(axes: Any, x: Array, y: Array, af: Array) -> Any:
    """Draw values on an even grid, (Y, X). An image is drawn faster than a mesh."""
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
