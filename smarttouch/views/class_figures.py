"""Figures of the classes of receptors: thresholds by frequency (the paper's Fig. 2), responses over
time; and of one finger: its afferents, what is delivered to it, and its response."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import in_color, response_map
from smarttouch.physiology.spikes import SlotCurrents, SpikeModel
from smarttouch.physiology.vibration_thresholds import PC_BAND_HZ, RA_BAND_HZ, threshold_um
from smarttouch.views.figure_style import GREY, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_BANDS_HZ = {Afferent.RA: RA_BAND_HZ, Afferent.PC: PC_BAND_HZ}
_MOST_POINTS = 20_000


@dataclass(frozen=True, eq=False)
class ClassRow:
    """Data of one class in the figure.

    ``drive`` is the response at each time of the trace, (N,) in [0, 1]; its K pulses are at
    ``pulse_s``, as strong as ``pulse_drive``, and levels held until the next one if ``vibrated``.
    """

    drive: Array
    pulse_s: Array
    pulse_drive: Array
    vibrated: bool = False


def thresholds_figure() -> "Figure":
    """Draw the detection thresholds of RA, SAI and PC by frequency, with the paper's bands."""
    frequency_hz = np.geomspace(0.5, 1000, 400)
    figure = new_figure(5.6, 3.6)
    axes = figure.subplots()
    for afferent in (Afferent.SAI, Afferent.RA, Afferent.PC):
        color = CLASS_COLORS[afferent]
        axes.plot(frequency_hz, threshold_um(afferent, frequency_hz), color=color,
                  label=afferent.name)  # fmt: skip
        if afferent in _BANDS_HZ:
            band = np.array(_BANDS_HZ[afferent])
            axes.plot(band, threshold_um(afferent, band), "|", color=color, ms=9, mew=1.5)
    axes.set(xscale="log", yscale="log", ylim=(0.1, 3000))
    _plain_ticks(axes, (1, 3, 10, 30, 100, 300, 1000))
    axes.set_yticks([0.1, 1, 10, 100, 1000], ["0.1", "1", "10", "100", "1000"])
    axes.legend(frameon=False, fontsize=8)
    title = "Detection threshold of each class (| the paper's bands)"
    plain(axes, title, "frequency (Hz)", "amplitude (µm)")
    return figure


def color_figure(
    time_s: Array,
    displacement_um: Array,
    force_n: Array,
    rows: Mapping[Afferent, ClassRow],
    title: str,
) -> "Figure":
    """Draw a trace, (N,) each, the response of each class, and the pulses of each."""
    figure = new_figure(8.4, 2.0 + 1.15 * len(rows))
    panels = figure.subplots(
        1 + len(rows), 1, sharex=True, squeeze=False, height_ratios=[1.3] + [1] * len(rows)
    )[:, 0]
    _draw_trace(panels[0], time_s, displacement_um, force_n, title)
    for axes, (afferent, row) in zip(panels[1:], rows.items(), strict=True):
        _draw_class(axes, time_s, afferent, row)
    panels[-1].set_xlabel("time (s)", fontsize=8)
    panels[-1].set_xlim(time_s[0], time_s[-1])
    return figure


def _draw_trace(axes: Any, time_s: Array, moved_um: Array, force_n: Array, title: str) -> None:
    part = _thinned(time_s)
    axes.plot(time_s[part], moved_um[part], color=GREY, lw=0.6)
    plain(axes, title, "", "skin (µm)")
    if force_n.any():
        pressed = axes.twinx()
        pressed.plot(time_s[part], force_n[part], color=CLASS_COLORS[Afferent.SAI], lw=1.2)
        pressed.set_ylim(0, 1.15 * float(force_n.max()))
        plain(pressed, "", "", "force (N)")
        pressed.spines["right"].set_visible(True)
        pressed.yaxis.label.set_color(CLASS_COLORS[Afferent.SAI])


def _draw_class(axes: Any, time_s: Array, afferent: Afferent, row: ClassRow) -> None:
    color, part = CLASS_COLORS[afferent], _thinned(time_s)
    axes.fill_between(time_s[part], row.drive[part], color=color, alpha=0.25, lw=0)
    what = "response"
    if row.vibrated:
        axes.step(row.pulse_s, row.pulse_drive, where="post", color=color, lw=0.9)
        what = "response, and vibration"
    elif len(row.pulse_s):
        axes.vlines(row.pulse_s, 0, row.pulse_drive, color=color, lw=0.7)
        what = f"response, and {len(row.pulse_s)} pulses"
    axes.set_ylim(0, 1.05)
    plain(axes, "", "", "drive")
    box = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1.5}
    axes.text(
        0.005,
        0.97,
        f"{afferent.name} {what}",
        transform=axes.transAxes,
        va="top",
        fontsize=7.5,
        bbox=box,
    )


def _thinned(time_s: Array) -> slice:
    return slice(None, None, max(1, len(time_s) // _MOST_POINTS))


def _plain_ticks(axes: Any, ticks: Sequence[float]) -> None:
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.minorticks_off()


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
