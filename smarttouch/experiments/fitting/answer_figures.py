"""Figures of answers: shares by comparison, and the thresholds fitted to them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from smarttouch.experiments.fitting.answers import AnswerTable
from smarttouch.experiments.fitting.findings import Finding
from smarttouch.experiments.fitting.fit import Bounded
from smarttouch.views.figure_style import GREY, SERIES_COLORS, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_MARKERS = ("o", "s", "D", "^", "v", "P")
_TOP_IN, _BOTTOM_IN = 2.7, 2.9
_SIDE_IN = 4.6
_RATIO_TICKS = (0.25, 0.33, 0.5, 0.67, 0.8, 1, 1.25, 1.5, 2, 3, 4)
_FEWEST_FOR_INTERVAL = 3
"""Fewest answers at a comparison for which the interval of their share is drawn."""


Series = tuple[AnswerTable, Sequence[Finding]]  # results of one file


def discrimination_figure(series: Sequence[Series]) -> "Figure":
    """Draw shares of answers above, thresholds below.

    With standards: one panel of each series with a curve of each standard, and one with the
    thresholds of all. Without: one panel with a curve of each series, thresholds on it.
    """
    if not all(found.standard for _, findings in series for found in findings):
        return _without_standards(series)
    count = len(series)
    figure = new_figure(max(5.2, _SIDE_IN * count), _TOP_IN + _BOTTOM_IN)
    grid = figure.add_gridspec(2, count, height_ratios=[_TOP_IN, _BOTTOM_IN])
    shades, shares = _shades(series), None
    for index, each in enumerate(series):
        shares = figure.add_subplot(grid[0, index], sharey=shares)
        _draw_shares(shares, each, shades, _title(each[0].name if count > 1 else "", index))
    _draw_thresholds(figure.add_subplot(grid[1, :]), series, _title("", count))
    return figure


def binomial_interval(k: Array, n: Array) -> tuple[Array, Array]:
    """Return Clopper and Pearson's exact 95 % interval of k successes in n trials (1934)."""
    tail = 0.025
    low = betaincinv(np.maximum(k, 0.5), n - k + 1, tail)
    high = betaincinv(k + 1, np.maximum(n - k, 0.5), 1 - tail)
    return np.where(k > 0, low, 0.0), np.where(k < n, high, 1.0)


def _title(name: str, index: int) -> str:
    return f"({'abcdefghij'[index % 10]}) {name}".rstrip()


def _shades(series: Sequence[Series]) -> dict[float, Any]:
    """Return the color of each standard, from dark to light, distinct in grey print, too."""
    from matplotlib import colormaps

    standards = sorted({judged.standard for _, findings in series for judged in findings})
    places = np.linspace(0.0, 0.85, len(standards))
    return {
        each: colormaps["viridis"](place) for each, place in zip(standards, places, strict=True)
    }


def _draw_shares(axes: Any, series: Series, shades: dict[float, Any], title: str) -> None:
    """Draw shares against comparison / standard, and the curves through them."""
    axes.axhline(0.5, color=GREY, lw=0.5)
    table, findings = series
    share = findings[0].model.share
    axes.axhline(share, color=GREY, lw=0.5, ls=":")
    edge = axes.get_yaxis_transform()
    axes.text(0.995, share, f"{share:.0%}", transform=edge, color=GREY, fontsize=6.5,
              ha="right", va="bottom")  # fmt: skip
    axes.axvline(1.0, color=GREY, lw=0.5)
    middle = (len(findings) - 1) / 2
    for place, judged in enumerate(findings):
        shade = shades[judged.standard]
        # Side by side: intervals at the same ratio would hide each other.
        ratio = judged.counts.stimulus / judged.standard * (1 + 0.006 * (place - middle))
        label = f"{judged.standard:g} {table.unit}".rstrip()
        _draw_points(axes, ratio, judged, shade, _MARKERS[place % 6], label)
        _draw_curve(axes, judged, judged.standard, shade)
    ratios = np.concatenate([each.counts.stimulus / each.standard for each in findings])
    _ratio_axis(axes, float(ratios.min()), float(ratios.max()))
    axes.legend(frameon=False, fontsize=7, title="standard", title_fontsize=7, loc="upper left")
    plain(axes, title, "comparison / standard", f"share {findings[0].said}")


def _draw_points(axes: Any, x: Array, judged: Finding, color: Any, marker: str, label: str) -> None:
    _, n, k = judged.counts
    low, high = binomial_interval(k, n)
    share = k / n
    # With few answers an interval is not informative, and hides the rest.
    enough = n >= _FEWEST_FOR_INTERVAL
    # Drawn as lists: Matplotlib 3.10 takes an array of one number for the number itself.
    reach = np.maximum([share - low, high - share], 0)[:, enough].tolist()
    axes.errorbar(
        x[enough], share[enough], yerr=reach, fmt="none", ecolor=color, elinewidth=0.6,
        alpha=0.4,
    )  # fmt: skip
    size = 8 + 2 * np.minimum(n, 10)
    axes.scatter(x, share, size, color=[color], marker=marker, label=label, lw=0, zorder=3)
    axes.set_ylim(-0.04, 1.04)


def _draw_curve(axes: Any, judged: Finding, unit: float, color: Any) -> None:
    if judged.curve is not None:
        stimulus, share = judged.curve
        style = "--" if judged.threshold is None else "-"
        axes.plot(stimulus / unit, share, style, color=color, lw=1.2)


def _ratio_axis(axes: Any, low: float, high: float) -> None:
    axes.set_xscale("log")
    ticks = [each for each in _RATIO_TICKS if 0.95 * low <= each <= 1.05 * high]
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.minorticks_off()


def _draw_thresholds(axes: Any, series: Sequence[Series], title: str) -> None:
    """Draw thresholds against standards; those beyond the range as an open arrow."""
    all_judged = [judged for _, findings in series for judged in findings]
    standards = sorted({judged.standard for judged in all_judged})
    gap = float(np.diff(standards).min()) if len(standards) > 1 else standards[0]
    highest = max(_end(judged) for judged in all_judged)
    axes.axhline(0, color=GREY, lw=0.6)
    axes.set_ylim(min(0.0, *(_lowest(judged) for judged in all_judged)) - 0.08, 1.15 * highest)
    for index, (table, findings) in enumerate(series):
        aside = 0.14 * gap * (index - (len(series) - 1) / 2)
        color, marker = SERIES_COLORS[index % 6], _MARKERS[index % 6]
        upper = [(each.standard + aside, each.threshold, each.standard) for each in findings]
        lower = [(each.standard + aside, each.lower, each.standard) for each in findings]
        _draw_bounded(axes, upper, color, marker + "-", f"{table.name}, above")
        _draw_bounded(axes, lower, color, marker + ":", f"{table.name}, below")
        for judged in findings:
            if judged.threshold is None:
                _draw_none(axes, judged, judged.standard + aside, color)
    axes.set_xlim(standards[0] - 0.6 * gap, standards[-1] + 0.6 * gap)
    axes.set_xticks(standards, [f"{each:g}" for each in standards])
    axes.legend(frameon=False, fontsize=7, title="threshold", title_fontsize=7, ncols=len(series))
    plain(
        axes, title, f"standard{_unit(series)}",
        f"{all_judged[0].model.share:.0%} threshold, change / standard",
    )  # fmt: skip


def _end(judged: Finding) -> float:
    """Return the largest comparison tested, as a relative difference from the standard."""
    return float(judged.counts.stimulus.max()) / judged.standard - 1


def _lowest(judged: Finding) -> float:
    bounded = judged.lower or judged.threshold
    if bounded is None:
        return 0.0
    return max(bounded[1], float(judged.counts.stimulus.min())) / judged.standard - 1


def _draw_bounded(
    axes: Any, points: list[tuple[float, Bounded | None, float]], color: str, style: str, label: str
) -> None:
    """Draw thresholds as parts of their standards; lines go only from neighbor to neighbor."""
    table = np.array([(x, *(bounded or (np.nan,) * 3), unit) for x, bounded, unit in points]).T
    x, (value, low, high) = table[0], table[1:4] / table[4] - 1
    bottom, top = axes.get_ylim()
    # Bars that leave the axes end there without a cap.
    reach = [
        (value - np.maximum(low, bottom - 1)).tolist(),
        (np.minimum(high, top + 1) - value).tolist(),
    ]
    fill = "white" if style.endswith(":") else color
    axes.errorbar(
        x, value, yerr=reach, fmt=style, color=color, mfc=fill, capsize=2.5, ms=5, lw=1,
        elinewidth=0.9, label=label,
    )  # fmt: skip


def _draw_none(axes: Any, judged: Finding, x: float, color: str) -> None:
    """Draw an open arrow at the end of the range tested, with the side of the threshold."""
    down = judged.beyond < 0
    end = float(judged.counts.stimulus.min()) / judged.standard - 1 if down else _end(judged)
    bottom, top = axes.get_ylim()
    length = 0.1 * (top - bottom) * (-1 if down else 1)
    axes.annotate(
        "", (x, end + length / 2), (x, end - length / 2),
        arrowprops={
            "arrowstyle": "-|>", "fc": "white", "ec": color, "lw": 1, "mutation_scale": 12,
            "shrinkA": 0, "shrinkB": 0,
        },
    )  # fmt: skip
    words = {1: f"above\n{end:.2g}", -1: f"below\n{end:.2g}", 0: "none\nfound"}[judged.beyond]
    side = "bottom" if down else "top"
    axes.text(x, end - 0.65 * length, words, color=color, fontsize=7, ha="center", va=side)


def _without_standards(series: Sequence[Series]) -> "Figure":
    """Draw shares against the stimulus itself; thresholds lie on the curves, with intervals."""
    figure = new_figure(5.2, 3.2)
    axes = figure.subplots()
    for index, (table, findings) in enumerate(series):
        color, marker = SERIES_COLORS[index % 6], _MARKERS[index % 6]
        for judged in findings:
            label = table.name + (", no threshold" if judged.threshold is None else "")
            _draw_points(axes, judged.counts.stimulus, judged, color, marker, label)
            _draw_curve(axes, judged, 1.0, color)
            if judged.threshold is None or judged.curve is None:
                continue
            value, low, high = judged.threshold
            share = np.interp(value, *judged.curve)
            ends = np.clip([low, high], judged.counts.stimulus.min(), judged.counts.stimulus.max())
            axes.plot(ends, [share, share], color=color, lw=3, alpha=0.4)
            axes.plot([value], [share], "|", ms=14, color=color)
    axes.legend(frameon=False, fontsize=7)
    plain(axes, "", f"stimulus{_unit(series)}", f"share {series[0][1][0].said}")
    return figure


def _unit(series: Sequence[Series]) -> str:
    return f" ({series[0][0].unit})" if series[0][0].unit else ""
