"""Figure of a pattern on one finger: its afferents, what is delivered to it, and its response."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import in_color, response_map
from smarttouch.physiology.spikes import SlotCurrents, SpikeModel
from smarttouch.views.figure_style import GREY, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PIXELS = 120
_QUIET = "#d8d8d8"


def letter_figure(finger: Finger, slots: SlotCurrents, active: NDArray[np.bool_]) -> "Figure":
    """Draw a pattern on a finger: delivered, fired, response, and afferents from the side."""
    counts = SpikeModel(finger).fire(slots).counts
    figure = new_figure(10.5, 6.0)
    parts: Any = figure.subfigures(2, 1, height_ratios=(3.6, 2.0))
    above, below = parts
    delivered, fired, response = above.subplots(1, 3, sharey=True)
    side = below.subplots()
    _draw_array(delivered, finger, active)
    _draw_courses(fired, finger, counts, 1)
    _draw_array(fired, finger, active, outline=True)
    _draw_response(response, finger, counts)
    _draw_array(response, finger, active, outline=True)
    _draw_courses(side, finger, counts, 2)
    half_x, half_y = finger.reach_mm
    for axes in (delivered, fired, response):
        axes.set_xlim(-half_x, half_x)
        axes.set_ylim(half_y, -half_y)
        axes.set_aspect("equal")
    side.set_xlim(-half_y, half_y)
    deepest = max(one.axon_path_mm[:, 1, 2].max() for one in finger.populations.values())
    side.set_ylim(min(deepest, 3.0) + 0.5, 0)
    plain(delivered, "Delivered: active electrodes", "x (mm)", "y (mm), fingertip above")
    plain(fired, "Fired: axons in color, dots are their endings", "x (mm)")
    plain(response, "Felt: spikes where the receptors are", "x (mm)")
    plain(
        side, f"The same axons from the side: {finger.anatomy.title}",
        "y (mm), fingertip at the left", "depth (mm)",
    )  # fmt: skip
    for afferent, color in CLASS_COLORS.items():
        of_class = finger.classes == afferent
        label = f"{afferent.name}: {np.sum(of_class & (counts > 0))} of {of_class.sum()} fired"
        side.plot([], [], color=color, lw=2, label=label)
    side.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False)
    return figure


def _draw_array(
    axes: Any, finger: Finger, active: NDArray[np.bool_], outline: bool = False
) -> None:
    from matplotlib.patches import Circle

    radius = finger.profile.electrodes.pitch_mm / 4
    for place, on in zip(finger.profile.electrodes.position_mm, active, strict=True):
        if on or not outline:
            color = "none" if outline or not on else "black"
            line = "black" if outline else GREY
            axes.add_patch(Circle(place, radius, facecolor=color, edgecolor=line, lw=0.6, zorder=3))


def _draw_courses(axes: Any, finger: Finger, counts: NDArray[np.intp], across: int) -> None:
    """Draw courses in the plane of x and y (across 1), or of y and depth (2)."""
    from matplotlib.collections import LineCollection

    first = 0
    for afferent, one in finger.populations.items():
        fires = (counts[first : first + len(one.factor)] > 0)[one.owner]
        first += len(one.factor)
        for which, color, width, order in (
            (~fires, _QUIET, 0.2, 1), (fires, CLASS_COLORS[afferent], 0.6, 2 + 1 / (1 + afferent)),
        ):  # fmt: skip
            lines = one.axon_path_mm[which][..., across - 1 : across + 1]
            # Many that cross must stay distinguishable.
            alpha = min(1.0, 20 / max(1, len(lines)) ** 0.5)
            axes.add_collection(
                LineCollection(
                    list(lines), colors=color, linewidths=width, zorder=order, alpha=alpha
                )
            )
            axes.plot(
                *lines[:, 0].T, ".", color=color, ms=1 if color == _QUIET else 3, zorder=order
            )


def _draw_response(axes: Any, finger: Finger, counts: NDArray[np.intp]) -> None:
    half_x, half_y = finger.reach_mm
    x, y = np.meshgrid(np.linspace(-half_x, half_x, _PIXELS), np.linspace(-half_y, half_y, _PIXELS))
    spikes = response_map(finger, counts, np.column_stack([x.ravel(), y.ravel()]), 0.6)
    shown = in_color(spikes, float(spikes.sum(axis=0).max())).reshape(_PIXELS, _PIXELS, 3)
    axes.imshow(shown, extent=(-half_x, half_x, half_y, -half_y), interpolation="bilinear")
