"""Figures of fibers and the activating function: thresholds by depth, strength by duration."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.physiology.af_error import DEPTHS_MM, AfError, potential_at_nodes
from smarttouch.physiology.membrane import Fiber, strength_duration, weiss_fit
from smarttouch.plotting.style import ANODIC, CATHODIC, new_figure, plain
from smarttouch.profile import Profile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLORS = {"cathodic": CATHODIC, "anodic": ANODIC}
_WIDTHS_US = (20.0, 35.0, 60.0, 100.0, 200.0, 350.0, 600.0, 1000.0)
_FITTED = 5
"""Widths up to 200 µs, as in boards; beyond, sodium inactivates and Weiss' law ends."""


def af_error_figure(table: Sequence[AfError]) -> "Figure":
    """Draw the thresholds that the AF predicts beside those of the cable model."""
    fibers = list(dict.fromkeys(row.fiber for row in table))
    figure = new_figure(8.4, 3.2)
    for axes, fiber in zip(
        figure.subplots(1, len(fibers), sharey=True, squeeze=False)[0], fibers, strict=True
    ):
        for polarity, color in _COLORS.items():
            rows = [row for row in table if (row.fiber, row.polarity) == (fiber, polarity)]
            depths = [row.depth_mm for row in rows]
            axes.plot(depths, [row.cable_ma for row in rows], "o-", color=color, ms=3.5,
                      label=f"{polarity}, cable model")  # fmt: skip
            predicted = np.array([row.af_ma for row in rows])
            label = f"{polarity}, from the AF"
            if np.isinf(predicted).all():
                label += ": never"
            axes.plot(depths, np.where(np.isinf(predicted), np.nan, predicted), "--", color=color,
                      label=label)  # fmt: skip
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(DEPTHS_MM, [f"{depth:g}" for depth in DEPTHS_MM])
        axes.legend(frameon=False, fontsize=6.5, loc="upper left")
        plain(axes, fiber, "depth (mm)", "threshold (mA)" if fiber == fibers[0] else "")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * 6)
    return figure


def strength_duration_figure(profile: Profile) -> "Figure":
    """Draw threshold against pulse width for a fiber of each class, with Weiss' law."""
    skin = profile.skin
    cases = (
        ("SAI, flat, cathodic", Fiber(end="through"), skin.sai_depth_mm, True, CATHODIC, "o-"),
        ("SAI, flat, anodic", Fiber(end="through"), skin.sai_depth_mm, False, ANODIC, "o-"),
        ("RA, passive ending, anodic", Fiber(end="passive"), skin.ra_depth_mm, False, ANODIC, "s:"),
    )
    figure = new_figure(5.6, 3.6)
    axes = figure.subplots()
    for name, fiber, depth, cathodic, color, style in cases:
        potential = potential_at_nodes(profile, fiber, depth)
        thresholds = strength_duration(potential, fiber, _WIDTHS_US, cathodic=cathodic)
        rheobase, chronaxie = weiss_fit(_WIDTHS_US[:_FITTED], thresholds[:_FITTED])
        axes.plot(_WIDTHS_US, thresholds, style, color=color, ms=3.5,
                  label=f"{name}: {rheobase:.2g} mA, {chronaxie:.0f} µs")  # fmt: skip
    axes.set(xscale="log", yscale="log")
    ticks = [20, 50, 100, 200, 500, 1000]
    axes.set_xticks(ticks, [str(each) for each in ticks])
    strengths = [1, 2, 5, 10, 20]
    axes.set_yticks(strengths, [str(each) for each in strengths])
    axes.minorticks_off()
    axes.legend(
        frameon=False, fontsize=7, title="rheobase and chronaxie to 200 µs", title_fontsize=7
    )
    plain(axes, "Strength and duration under one electrode", "pulse width (µs)", "threshold (mA)")
    return figure
