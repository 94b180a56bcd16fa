"""Figures of receptors and colors: drawn from what they are given, and no more."""

import numpy as np
import pytest

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.views.class_figures import ClassRow, color_figure, thresholds_figure

from ..said import numbers_in


def test_thresholds_are_drawn_with_the_bands_of_the_paper():
    (axes,) = thresholds_figure().axes
    curves = {line.get_label(): line for line in axes.lines if len(line.get_xdata()) > 2}
    assert set(curves) == {"RA", "SAI", "PC"}
    lowest = curves["PC"].get_xdata()[np.argmin(curves["PC"].get_ydata())]
    assert lowest == pytest.approx(250, rel=0.02)
    bands = [tuple(line.get_xdata()) for line in axes.lines if len(line.get_xdata()) == 2]
    assert set(bands) == {(20, 70), (60, 800)}


@pytest.mark.parametrize("pressed", [False, True])
def test_a_panel_for_the_trace_and_one_for_each_class(pressed):
    time_s = np.arange(50_000) / 4000
    pulse_s, drive = np.array([0.1, 0.2]), np.array([0.5, 0.7])
    rows = {
        Afferent.RA: ClassRow(np.full(50_000, 0.5), pulse_s, drive),
        Afferent.PC: ClassRow(np.zeros(50_000), pulse_s, drive, vibrated=True),
    }
    figure = color_figure(time_s, np.sin(time_s), np.full(50_000, 0.4 * pressed), rows, "a trace")
    figure.canvas.draw()
    top, ra, pc, *force = figure.axes
    assert top.get_title(loc="left") == "a trace"
    assert len(force) == pressed
    assert len(top.lines[0].get_xdata()) <= 25_000  # no more than is seen
    (_, pulses) = ra.collections
    assert len(pulses.get_segments()) == 2
    assert pulses.get_segments()[1][1].tolist() == [0.2, 0.7]
    for axes, name, numbers in ((ra, "RA", [2]), (pc, "PC", [])):
        text = axes.texts[0].get_text()
        assert text.startswith(name)
        assert numbers_in(text) == numbers, "pulses; none where vibrators shake"
    assert pc.lines[0].get_color() == CLASS_COLORS[Afferent.PC]
