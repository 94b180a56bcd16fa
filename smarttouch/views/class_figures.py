"""Figures of the classes of receptors: thresholds by frequency (the paper's Fig. 2), and responses
over time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS, Afferent
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
