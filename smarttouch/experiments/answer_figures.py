"""Figures of answers: shares by comparison, and the thresholds fitted to them."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from smarttouch.experiments.answers import AnswerTable
from smarttouch.experiments.findings import Finding
from smarttouch.views.figure_style import GREY, SERIES_COLORS, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_TICKS = (0.25, 0.33, 0.5, 0.67, 0.8, 1, 1.25, 1.5, 2, 3, 4)  # of comparison / standard
_FEWEST_FOR_INTERVAL = 3  # answers at a comparison; with fewer an interval hides the rest

Series = tuple[AnswerTable, Sequence[Finding]]  # results of one file


def discrimination_figure(series: Sequence[Series]) -> "Figure":
    """Draw shares of answers above, thresholds below.

    With standards: one panel of each series with a curve of each standard, and one with the
    thresholds of all. Without: one panel with a curve of each series, thresholds on it.
    """
    if not all(found.standard for _, findings in series for found in findings):
        return _without_standards(series)
    figure = new_figure(max(5.2, 4.6 * len(series)), 5.6)
    grid = figure.add_gridspec(2, len(series))
    for index, (table, findings) in enumerate(series):
        axes = figure.add_subplot(grid[0, index])
        for place, found in enumerate(findings):
            shift = 1 + 0.006 * (place - len(findings) / 2)  # intervals would hide each other
            _draw_shares(axes, found, found.standard, shift, SERIES_COLORS[place % 6],
                         f"{found.standard:g} {table.unit}".rstrip())  # fmt: skip
        axes.axhline(findings[0].model.share, color=GREY, lw=0.5, ls=":")
        axes.axvline(1.0, color=GREY, lw=0.5)
        axes.set_xscale("log")
        low, high = axes.get_xlim()
        ticks = [each for each in _TICKS if low <= each <= high]
        axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
        axes.minorticks_off()
        axes.legend(frameon=False, fontsize=7, title="standard", title_fontsize=7)
        plain(axes, table.name, "comparison / standard", f"share {findings[0].said}")
    _draw_thresholds(figure.add_subplot(grid[1, :]), series)
    return figure


def binomial_interval(k: Array, n: Array) -> tuple[Array, Array]:
    """Return Clopper and Pearson's exact 95 % interval of k successes in n trials (1934)."""
    tail = 0.025
    low = betaincinv(np.maximum(k, 0.5), n - k + 1, tail)
    high = betaincinv(k + 1, np.maximum(n - k, 0.5), 1 - tail)
    return np.where(k > 0, low, 0.0), np.where(k < n, high, 1.0)


def _draw_shares(
    axes: Any, found: Finding, unit: float, shift: float, color: str, label: str
) -> None:
    """Draw shares, their intervals, and the curve through them against stimulus / unit."""
    stimulus, n, k = found.counts
    low, high = binomial_interval(k, n)
    share, enough = k / n, n >= _FEWEST_FOR_INTERVAL
    # Drawn as lists: Matplotlib 3.10 takes an array of one number for the number itself.
    reach = np.maximum([share - low, high - share], 0)[:, enough].tolist()
    x = stimulus / unit * shift
    axes.errorbar(x[enough], share[enough], reach, fmt="none", ecolor=color, lw=0.6, alpha=0.4)
    axes.scatter(x, share, 8 + 2 * np.minimum(n, 10), color=[color], label=label, lw=0, zorder=3)
    axes.set_ylim(-0.04, 1.04)
    if found.curve is not None:
        x, share = found.curve
        axes.plot(x / unit, share, "--" if found.threshold is None else "-", color=color, lw=1.2)


def _draw_thresholds(axes: Any, series: Sequence[Series]) -> None:
    """Draw thresholds as parts of their standards; an arrow points to those beyond the range."""
    axes.axhline(0, color=GREY, lw=0.6)
    for index, (table, findings) in enumerate(series):
        color = SERIES_COLORS[index % 6]
        aside = 1 + 0.01 * (index - (len(series) - 1) / 2)
        for name, style in (("threshold", "o-"), ("lower", "o:")):
            rows = [(each.standard, *(getattr(each, name) or [np.nan] * 3)) for each in findings]
            standard, *bounded = np.array(rows).T
            value, low, high = np.array(bounded) / standard - 1
            # An end that is not determined lies at the farthest comparison.
            reach = np.array([value - low, high - value])
            reach = np.where(np.isinf(reach), np.abs(value), reach).tolist()
            axes.errorbar(standard * aside, value, reach, fmt=style, color=color, ms=4, lw=1,
                          capsize=2.5, label=f"{table.name}, {name}")  # fmt: skip
        for each in findings:
            if each.threshold is None:
                ends = each.counts.stimulus[[0, -1]] / each.standard - 1
                place = {1: ends[1], -1: ends[0], 0: 0.0}[each.beyond]
                words = {1: f"↑ above\n{place:.2g}", -1: f"↓ below\n{place:.2g}", 0: "none"}
                axes.text(each.standard * aside, place, words[each.beyond], color=color,
                          fontsize=7, ha="center", va="center")  # fmt: skip
                axes.update_datalim([(each.standard, place)])
    axes.autoscale_view()
    standards = sorted({each.standard for _, findings in series for each in findings})
    axes.set_xticks(standards, [f"{each:g}" for each in standards])
    axes.legend(frameon=False, fontsize=7, ncols=len(series))
    share = series[0][1][0].model.share
    plain(axes, "", f"standard{_unit(series)}", f"{share:.0%} threshold, change / standard")


def _without_standards(series: Sequence[Series]) -> "Figure":
    """Draw shares against the stimulus itself; thresholds lie on the curves, with intervals."""
    figure = new_figure(5.2, 3.2)
    axes = figure.subplots()
    for index, (table, findings) in enumerate(series):
        color = SERIES_COLORS[index % 6]
        for found in findings:
            label = table.name + (", no threshold" if found.threshold is None else "")
            _draw_shares(axes, found, 1.0, 1.0, color, label)
            if found.threshold is None or found.curve is None:
                continue
            value, low, high = found.threshold
            share = np.interp(value, *found.curve)
            ends = np.clip([low, high], found.counts.stimulus.min(), found.counts.stimulus.max())
            axes.plot(ends, [share, share], color=color, lw=3, alpha=0.4)
            axes.plot([value], [share], "|", ms=14, color=color)
    axes.legend(frameon=False, fontsize=7)
    plain(axes, "", f"stimulus{_unit(series)}", f"share {series[0][1][0].said}")
    return figure


def _unit(series: Sequence[Series]) -> str:
    return f" ({series[0][0].unit})" if series[0][0].unit else ""
