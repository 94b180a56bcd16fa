"""The chart shows every figure it was given, and says where there is none."""

from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.experiments.findings import binomial_interval, discrimination_figure
from smarttouch.experiments.psychometric import Counts
from smarttouch.views.figure_style import save

from ...said import numbers_in

RATIOS = np.array([0.5, 0.75, 1.25, 2.0])
N = np.full(4, 10.0)


def finding(standard, counts, curve=None, threshold=None, lower=None, beyond=0):
    """Return what the chart takes of a `Finding`."""
    return SimpleNamespace(
        standard=standard, counts=Counts(*counts), curve=curve, threshold=threshold, lower=lower,
        beyond=beyond, said="judged higher" if standard else "felt",
        model=SimpleNamespace(share=0.75 if standard else 0.5),
    )  # fmt: skip


def judged(standard, threshold=None, lower=None, beyond=0, curve=True):
    stimulus = standard * RATIOS
    line = np.stack([np.linspace(stimulus[0], stimulus[-1], 50), np.linspace(0, 1, 50)])
    counts = stimulus, N, np.array([0.0, 2, 8, 10])
    return finding(standard, counts, line if curve else None, threshold, lower, beyond)


def series(name, *findings, unit="Hz"):
    return SimpleNamespace(name=name, unit=unit), findings


def words(axes):
    return [each.get_text() for each in axes.texts if each.get_text()]


def bars(axes):
    """Return what error bars show in data coordinates: of each, points (P, 2)."""
    return [each.lines[0].get_xydata() for each in axes.containers]


def test_two_modes():
    figure = discrimination_figure(
        [
            series(
                "RA",
                judged(30.0, (36.0, 33.0, 39.0), (27.0, 25.5, 28.5)),
                judged(60.0, (90.0, 75.0, np.inf)),
                judged(75.0, beyond=1),
                judged(90.0, curve=False),
            ),
            series("PC", judged(60.0, (66.0, 63, 69)), judged(90.0, beyond=-1)),
        ]
    )
    ra, pc, thresholds = figure.axes
    assert (ra.get_title(loc="left"), pc.get_title(loc="left")) == ("RA", "PC")
    assert [each.get_text() for each in ra.get_legend().get_texts()] == [
        "30 Hz", "60 Hz", "75 Hz", "90 Hz",
    ]  # fmt: skip
    dots = np.asarray(ra.collections[-1].get_offsets())
    assert dots[:, 0] == pytest.approx(RATIOS, rel=0.02)
    assert dots[:, 1] == pytest.approx([0, 0.2, 0.8, 1.0])
    # A curve of each but the last; dashed where it gives no threshold.
    curves = [line for line in ra.lines if len(line.get_xdata()) == 50]
    assert [line.get_linestyle() for line in curves] == ["-", "-", "--"]
    upper, lower, other, _ = bars(thresholds)
    assert upper[:2] == pytest.approx(np.array([[30, 0.2], [60, 0.5]]), rel=0.01)
    assert np.isnan(upper[2:, 1]).all()
    assert lower[0] == pytest.approx([30, -0.1], rel=0.01)
    assert upper[1, 0] < 60 < other[0, 0]
    (segment, *_) = thresholds.containers[0].lines[2][0].get_segments()
    assert segment[:, 1] == pytest.approx([0.1, 0.3])
    # The end of the range beyond which it lies; nothing where none was found.
    assert [numbers_in(each) for each in words(thresholds)] == [[1], [], [-0.5]]
    assert "75%" in thresholds.get_ylabel()
    assert [tick.get_text() for tick in thresholds.get_xticklabels()] == ["30", "60", "75", "90"]


def test_without_standards(tmp_path):
    line = np.stack([np.linspace(0, 3, 40), np.linspace(0, 1, 40)])
    k = np.array([0.0, 3, 7, 10])
    felt = finding(0.0, (np.array([0.0, 1, 2, 3]), N, k), line, (1.5, 1, 2))
    nothing = finding(0.0, (np.array([1.0, 2]), N[:2], np.zeros(2)), beyond=1)
    figure = discrimination_figure(
        [series("one", felt, unit="mA"), series("two", nothing, unit="mA")]
    )
    (axes,) = figure.axes
    one, two = (each.get_text() for each in axes.get_legend().get_texts())
    assert one == "one"
    # More is said of the series that has no threshold.
    assert two.startswith("two, ")
    assert "(mA)" in axes.get_xlabel()
    assert "felt" in axes.get_ylabel()
    # The interval of the threshold, at the share that the curve has there.
    (interval,) = [line.get_xydata() for line in axes.lines if line.get_linewidth() == 3]
    assert interval == pytest.approx(np.array([[1, 0.5], [2, 0.5]]), abs=1e-6)
    save(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_binomial_interval():
    """Clopper and Pearson: none of ten, 1 - 0.025^(1/10); all; and 5 of 10 from tables."""
    low, high = binomial_interval(np.array([0.0, 10, 5]), np.full(3, 10.0))
    assert low == pytest.approx([0, 0.025**0.1, 0.1871], abs=1e-4)
    assert high == pytest.approx([1 - 0.025**0.1, 1, 0.8129], abs=1e-4)
