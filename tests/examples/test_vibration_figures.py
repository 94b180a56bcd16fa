"""Figures of receptors and colors: drawn from what they are given, and no more."""

import numpy as np
import pytest
from studies.vibration_figures import draw_mixture, thresholds_figure

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.instruments.color_mix import mix_colors
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.kernels.bank import load_bank

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
def test_a_panel_for_the_trace_and_one_for_each_class(profile, pressed):
    trace = open_trace("tone:30Hz,8um+tone:250Hz,2um" + "+press:0.4N" * pressed, seconds=8.0)
    mixture = mix_colors(trace, profile, load_bank(profile), vibrated=True)
    figure = draw_mixture(trace, mixture)
    figure.canvas.draw()
    top, ra, sai, pc, *force = figure.axes
    assert top.get_title(loc="left") == trace.title
    assert len(force) == pressed
    assert len(top.lines[0].get_xdata()) <= 20_000  # no more than is seen
    pulses = {"RA": mixture.pulses(Afferent.RA), "SAI": mixture.pulses(Afferent.SAI)}
    assert (pulses["SAI"] > 0) is pressed
    for axes, name in ((ra, "RA"), (sai, "SAI"), (pc, "PC")):
        text, drawn = axes.texts[0].get_text(), pulses.get(name)
        assert text.startswith(name)
        assert numbers_in(text) == [drawn] * bool(drawn), "pulses; none where a vibrator plays"
        if drawn:
            assert len(axes.collections[1].get_segments()) == drawn
    assert pc.lines[0].get_color() == CLASS_COLORS[Afferent.PC]
