"""Figures of tactile primary colors: the thresholds of each class over frequency (the paper's Fig.
2), and the response and the pulses of each class over time."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.instruments.vibration_stimuli import Mixture
from smarttouch.instruments.vibration_trace import Trace
from smarttouch.physiology.vibration_thresholds import PC_BAND_HZ, RA_BAND_HZ, threshold_um
from smarttouch.views.figure_style import GREY, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_BANDS_HZ = {Afferent.RA: RA_BAND_HZ, Afferent.PC: PC_BAND_HZ}
_MOST_POINTS = 20_000


def thresholds_figure() -> "Figure":
    """Draw the detection thresholds of RA, SAI and PC over frequency, with the paper's bands."""
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
    ticks = (1, 3, 10, 30, 100, 300, 1000)
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.minorticks_off()
    axes.set_yticks([0.1, 1, 10, 100, 1000], ["0.1", "1", "10", "100", "1000"])
    axes.legend(frameon=False, fontsize=8)
    title = "Detection threshold of each class (|: edges of the paper's bands)"
    plain(axes, title, "frequency (Hz)", "amplitude (µm)")
    return figure


def draw_mixture(trace: Trace, mixture: Mixture) -> "Figure":
    """Draw a vibration, and the response and the pulses of each class."""
    time_s, answers = trace.time_s, mixture.answers
    figure = new_figure(8.4, 2.0 + 1.15 * len(answers))
    panels = figure.subplots(
        1 + len(answers), 1, sharex=True, squeeze=False, height_ratios=[1.3] + [1] * len(answers)
    )[:, 0]
    _draw_trace(panels[0], time_s, trace.displacement_um, trace.force_n, trace.title)
    for axes, afferent in zip(panels[1:], answers, strict=True):
        _draw_class(axes, time_s, afferent, mixture)
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


def _draw_class(axes: Any, time_s: Array, afferent: Afferent, mixture: Mixture) -> None:
    color, part = CLASS_COLORS[afferent], _thinned(time_s)
    axes.fill_between(
        time_s[part], mixture.answers[afferent].drive[part], color=color, alpha=0.25, lw=0
    )
    what = "response"
    if mixture.vibrated and afferent is Afferent.PC:
        axes.step(mixture.time_us / 1e6, mixture.drive[:, afferent], where="post", color=color,
                  lw=0.9)  # fmt: skip
        what = "response, and vibration"
    elif len(which := mixture.carried.get(afferent, ())):
        pulse_s, drive = mixture.time_us[which] / 1e6, mixture.drive[which, afferent]
        axes.vlines(pulse_s, 0, drive, color=color, lw=0.7)
        what = f"response, and {len(pulse_s)} pulses"
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
    return slice(None, None, -(-len(time_s) // _MOST_POINTS))
