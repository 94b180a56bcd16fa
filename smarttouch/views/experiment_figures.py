"""Figures of experiments and studies: shares of answers, thresholds, errors of choices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from smarttouch.views.figure_style import GREY, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Bounded = tuple[float, float, float]

SERIES_COLORS = ("#d55e00", "#009e73", "#0072b2", "#cc79a7", "#e69f00", "#56b4e9")
"""Colors of Okabe and Ito's set (2008); the first two are those of RA and PC elsewhere."""
_MARKERS = ("o", "s", "D", "^", "v", "P")
_TOP_IN, _BOTTOM_IN = 2.7, 2.9
_SIDE_IN = 4.6
_RATIO_TICKS = (0.25, 0.33, 0.5, 0.67, 0.8, 1, 1.25, 1.5, 2, 3, 4)
_FEWEST_FOR_INTERVAL = 3
"""Fewest answers at a comparison for which the interval of their share is drawn."""


@dataclass(frozen=True, eq=False)
class JudgedStandard:
    """Answers to one standard (0 if there is none), and their fit.

    Comparisons rise, (K,), with n answers and k successes each; the curve is (2, L), stimuli and
    fitted shares; thresholds are value and interval. ``beyond``: the threshold lies above (1) or
    below (-1) the range, 0 is unknown.
    """

    standard: float
    stimulus: Array
    n: Array
    k: Array
    curve: Array | None = None
    threshold: Bounded | None = None
    lower: Bounded | None = None
    beyond: int = 0


@dataclass(frozen=True, eq=False)
class JudgedSeries:
    """Results of one file: those of each standard, the share of answers at the threshold.

    ``said`` names a success: *judged higher*, *felt*.
    """

    name: str
    unit: str
    judged: tuple[JudgedStandard, ...]
    share: float
    said: str


def discrimination_figure(series: Sequence[JudgedSeries]) -> "Figure":
    """Draw shares of answers above, thresholds below.

    With standards: one panel of each series with a curve of each standard, and one with the
    thresholds of all. Without: one panel with a curve of each series, thresholds on it.
    """
    if not all(found.standard for each in series for found in each.judged):
        return _without_standards(series)
    count = len(series)
    figure = new_figure(max(5.2, _SIDE_IN * count), _TOP_IN + _BOTTOM_IN)
    grid = figure.add_gridspec(2, count, height_ratios=[_TOP_IN, _BOTTOM_IN])
    shades, shares = _shades(series), None
    for index, each in enumerate(series):
        shares = figure.add_subplot(grid[0, index], sharey=shares)
        _draw_shares(shares, each, shades, _title(each.name if count > 1 else "", index))
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


def _shades(series: Sequence[JudgedSeries]) -> dict[float, Any]:
    """Return the color of each standard, from dark to light, distinct in grey print, too."""
    from matplotlib import colormaps

    standards = sorted({judged.standard for each in series for judged in each.judged})
    places = np.linspace(0.0, 0.85, len(standards))
    return {
        each: colormaps["viridis"](place) for each, place in zip(standards, places, strict=True)
    }


def _draw_shares(axes: Any, series: JudgedSeries, shades: dict[float, Any], title: str) -> None:
    """Draw shares against comparison / standard, and the curves through them."""
    axes.axhline(0.5, color=GREY, lw=0.5)
    axes.axhline(series.share, color=GREY, lw=0.5, ls=":")
    edge = axes.get_yaxis_transform()
    axes.text(0.995, series.share, f"{series.share:.0%}", transform=edge, color=GREY, fontsize=6.5,
              ha="right", va="bottom")  # fmt: skip
    axes.axvline(1.0, color=GREY, lw=0.5)
    middle = (len(series.judged) - 1) / 2
    for place, judged in enumerate(series.judged):
        shade = shades[judged.standard]
        # Side by side: intervals at the same ratio would hide each other.
        ratio = judged.stimulus / judged.standard * (1 + 0.006 * (place - middle))
        label = f"{judged.standard:g} {series.unit}".rstrip()
        _draw_points(axes, ratio, judged, shade, _MARKERS[place % 6], label)
        _draw_curve(axes, judged, judged.standard, shade)
    ratios = np.concatenate([each.stimulus / each.standard for each in series.judged])
    _ratio_axis(axes, float(ratios.min()), float(ratios.max()))
    axes.legend(frameon=False, fontsize=7, title="standard", title_fontsize=7, loc="upper left")
    plain(axes, title, "comparison / standard", f"share {series.said}")


def _draw_points(
    axes: Any, x: Array, judged: JudgedStandard, color: Any, marker: str, label: str
) -> None:
    n, k = judged.n, judged.k
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


def _draw_curve(axes: Any, judged: JudgedStandard, unit: float, color: Any) -> None:
    if judged.curve is not None:
        stimulus, share = judged.curve
        style = "--" if judged.threshold is None else "-"
        axes.plot(stimulus / unit, share, style, color=color, lw=1.2)


def _ratio_axis(axes: Any, low: float, high: float) -> None:
    axes.set_xscale("log")
    ticks = [each for each in _RATIO_TICKS if 0.95 * low <= each <= 1.05 * high]
    axes.set_xticks(ticks, [f"{each:g}" for each in ticks])
    axes.minorticks_off()


def _draw_thresholds(axes: Any, series: Sequence[JudgedSeries], title: str) -> None:
    """Draw thresholds against standards; those beyond the range as an open arrow."""
    all_judged = [judged for each in series for judged in each.judged]
    standards = sorted({judged.standard for judged in all_judged})
    gap = float(np.diff(standards).min()) if len(standards) > 1 else standards[0]
    highest = max(_end(judged) for judged in all_judged)
    axes.axhline(0, color=GREY, lw=0.6)
    axes.set_ylim(min(0.0, *(_lowest(judged) for judged in all_judged)) - 0.08, 1.15 * highest)
    for index, each in enumerate(series):
        aside = 0.14 * gap * (index - (len(series) - 1) / 2)
        color, marker = SERIES_COLORS[index % 6], _MARKERS[index % 6]
        upper = [(each.standard + aside, each.threshold, each.standard) for each in each.judged]
        lower = [(each.standard + aside, each.lower, each.standard) for each in each.judged]
        _draw_bounded(axes, upper, color, marker + "-", f"{each.name}, above")
        _draw_bounded(axes, lower, color, marker + ":", f"{each.name}, below")
        for judged in each.judged:
            if judged.threshold is None:
                _draw_none(axes, judged, judged.standard + aside, color)
    axes.set_xlim(standards[0] - 0.6 * gap, standards[-1] + 0.6 * gap)
    axes.set_xticks(standards, [f"{each:g}" for each in standards])
    axes.legend(frameon=False, fontsize=7, title="threshold", title_fontsize=7, ncols=len(series))
    unit = f" ({series[0].unit})" if series[0].unit else ""
    plain(axes, title, f"standard{unit}", f"{series[0].share:.0%} threshold, change / standard")


def _end(judged: JudgedStandard) -> float:
    """Return the largest comparison tested, as a relative difference from the standard."""
    return float(judged.stimulus.max()) / judged.standard - 1


def _lowest(judged: JudgedStandard) -> float:
    bounded = judged.lower or judged.threshold
    if bounded is None:
        return 0.0
    return max(bounded[1], float(judged.stimulus.min())) / judged.standard - 1


def _draw_bounded(
    axes: Any,
    points: list[tuple[float, Bounded | None, float]],
    color: str,
    style: str,
    label: str,
) -> None:
    """Draw thresholds as parts of their standards; lines go only from neighbor to neighbor."""
    table = np.array([(x, *(bounded or (np.nan,) * 3), unit) for x, bounded, unit in points]).T
    x, (value, low, high) = table[0], table[1:4] / table[4] - 1
    bottom, top = axes.get_ylim()
    # What leaves the axes does so visibly, without a cap.
    reach = [
        (value - np.maximum(low, bottom - 1)).tolist(),
        (np.minimum(high, top + 1) - value).tolist(),
    ]
    fill = "white" if style.endswith(":") else color
    axes.errorbar(
        x, value, yerr=reach, fmt=style, color=color, mfc=fill, capsize=2.5, ms=5, lw=1,
        elinewidth=0.9, label=label,
    )  # fmt: skip


def _draw_none(axes: Any, judged: JudgedStandard, x: float, color: str) -> None:
    """Draw an open arrow at the end of the range tested, with the side of the threshold."""
    down = judged.beyond < 0
    end = float(judged.stimulus.min()) / judged.standard - 1 if down else _end(judged)
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


def _without_standards(series: Sequence[JudgedSeries]) -> "Figure":
    """Draw shares against the stimulus itself; thresholds lie on the curves, with intervals."""
    figure = new_figure(5.2, 3.2)
    axes = figure.subplots()
    for index, each in enumerate(series):
        color, marker = SERIES_COLORS[index % 6], _MARKERS[index % 6]
        for judged in each.judged:
            label = each.name + (", no threshold" if judged.threshold is None else "")
            _draw_points(axes, judged.stimulus, judged, color, marker, label)
            _draw_curve(axes, judged, 1.0, color)
            if judged.threshold is None or judged.curve is None:
                continue
            value, low, high = judged.threshold
            share = np.interp(value, *judged.curve)
            ends = np.clip([low, high], judged.stimulus.min(), judged.stimulus.max())
            axes.plot(ends, [share, share], color=color, lw=3, alpha=0.4)
            axes.plot([value], [share], "|", ms=14, color=color)
    axes.legend(frameon=False, fontsize=7)
    unit = f" ({series[0].unit})" if series[0].unit else ""
    plain(axes, "", f"stimulus{unit}", f"share {series[0].said}")
    return figure


_ROW_IN = 0.34
_PANEL_IN = 2.3


class SummedChoice(Protocol):
    """One choice on the fingers of one anatomy, as `studies.summary.Summed`."""

    @property
    def anatomy(self) -> str: ...
    @property
    def label(self) -> str: ...
    @property
    def fingers(self) -> Mapping[str, Sequence[float]]: ...


def study_figure(found: Sequence[SummedChoice], names: Mapping[str, str], title: str) -> "Figure":
    """Draw each measure in a panel: a dot for each finger, a line at the median of a choice."""
    anatomies = list(dict.fromkeys(each.anatomy for each in found))
    labels = list(dict.fromkeys(each.label for each in found))
    rows = len(labels) * len(anatomies)
    figure = new_figure(2.4 + _PANEL_IN * len(names), 1.5 + _ROW_IN * rows)
    panels = np.atleast_1d(figure.subplots(1, len(names), sharey=True))
    random = np.random.default_rng(0)
    for axes, (measure, name) in zip(panels, names.items(), strict=True):
        for each in found:
            place = labels.index(each.label) * (len(anatomies) + 0.6) + anatomies.index(
                each.anatomy
            )
            color = SERIES_COLORS[anatomies.index(each.anatomy) % len(SERIES_COLORS)]
            values = np.array([one for one in each.fingers[measure] if np.isfinite(one)])
            if not len(values):
                continue
            aside = random.uniform(-0.3, 0.3, len(values))
            axes.scatter(values, place + aside, s=6, color=color, alpha=0.45, linewidths=0)
            axes.plot([np.median(values)] * 2, [place - 0.42, place + 0.42], color="black", lw=1.6)
        plain(axes, "", name)
        most = max(0.1, axes.get_xlim()[1])
        axes.set_xlim(-0.03 * most, most)
        axes.grid(axis="x", color="#e6e6e6", linewidth=0.6)
        axes.set_axisbelow(True)
    middle = (len(anatomies) - 1) / 2
    panels[0].set_yticks(
        [index * (len(anatomies) + 0.6) + middle for index in range(len(labels))], labels
    )
    panels[0].invert_yaxis()
    for index, anatomy in enumerate(anatomies):
        color = SERIES_COLORS[index % len(SERIES_COLORS)]
        panels[0].scatter([], [], s=14, color=color, label=anatomy)
    panels[0].plot([], [], color="black", lw=1.6, label="median")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", fontsize=8,
        frameon=False, ncols=len(anatomies) + 1,
    )  # fmt: skip
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, color=GREY)
    return figure
