"""Figure of a study: each measure of each choice, finger by finger."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.experiments.study_run import Summed
from smarttouch.views.figure_style import GREY, SERIES_COLORS, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROW_IN = 0.34
_PANEL_IN = 2.3


def study_figure(found: Sequence[Summed], names: Mapping[str, str], title: str) -> "Figure":
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
