"""What a study found, as a table and a plot; of drawn fingers also what each figure hangs on."""

import csv
import io
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smarttouch.experiments.study_plan import Grid, Study, StudyRow
from smarttouch.experiments.study_priors import Prior
from smarttouch.experiments.study_run import (
    MEASURES,
    STUDY_NAMES,
    study_figure,
    study_sums,
    study_table,
)
from smarttouch.physiology.response import ignore_nan, middle_90
from smarttouch.views.figure_style import GREY, SERIES_COLORS, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
_NAMED = 2
"""Assumptions that are named beside each figure."""


@dataclass(frozen=True, eq=False)
class Uncertain:
    """One choice on the drawn fingers of one anatomy."""

    anatomy: str
    label: str  # what the choice is, where choices of the study differ
    priors: tuple[Prior, ...]  # assumptions, P of them
    values: Array  # (N, P) of each draw
    figures: dict[str, Array]  # (N,) of each draw: mean over its fingers; NaN where there is none

    def interval(self, figure: str) -> tuple[float, float, float]:
        """Return the median of the draws, and the bounds of their middle 90 %."""
        return middle_90(self.figures[figure])

    def rank_correlation(self, figure: str) -> Array:
        """Return Spearman's correlation of a figure with each assumption, (P,); 0 if it is
        constant."""
        from scipy.stats import rankdata

        known = np.isfinite(self.figures[figure])
        ranks = rankdata(np.column_stack([self.figures[figure], self.values])[known], axis=0)
        ranks -= ranks.mean(axis=0)
        lengths = np.linalg.norm(ranks, axis=0)
        both = ranks[:, 1:].T @ ranks[:, 0]
        return np.asarray(both / np.maximum(lengths[1:] * lengths[0], 1e-9))

    def moved(self, figure: str) -> Array:
        """Return a figure's medians over the draws with the lowest and with the highest third of
        each assumption, (P, 2)."""
        order = np.argsort(self.values, axis=0, kind="stable")
        third = max(1, len(order) // 3)
        thirds = self.figures[figure][np.stack([order[:third], order[-third:]])]
        return np.asarray(np.nanmedian(thirds, axis=1).T)


def uncertain_sums(
    rows: Sequence[StudyRow], priors: Sequence[Prior], values: Array
) -> list[Uncertain]:
    """Return each choice on the drawn fingers of each anatomy, in the order of the rows."""
    groups: dict[tuple[str, str], list[dict[str, float]]] = defaultdict(list)
    for each in study_sums(rows):
        anatomy = each.anatomy.rpartition("#")[0]
        means = {name: ignore_nan(fmean, each.fingers[name]) for name in MEASURES}
        groups[anatomy, each.label].append(means)
    return [
        Uncertain(
            anatomy, label, tuple(priors), values,
            {name: np.array([draw[name] for draw in draws]) for name in MEASURES},
        )
        for (anatomy, label), draws in groups.items()
    ]  # fmt: skip


def uncertain_table(found: Sequence[Uncertain]) -> tuple[list[str], list[list[str]]]:
    """Return a heading, and each figure with its interval and what it hangs on most."""
    lines = []
    for each in found:
        for figure, name in STUDY_NAMES.items():
            middle, low, high = each.interval(figure)
            ranks = each.rank_correlation(figure)
            most = np.argsort(-np.abs(ranks), kind="stable")[:_NAMED]
            hangs = [f"{each.priors[k].name.split(',')[0]} {ranks[k]:+.2f}" for k in most]
            lines.append(
                [each.anatomy, each.label, name, f"{middle:.3f}", f"{low:.3f} to {high:.3f}",
                 ", ".join(hangs)]
            )  # fmt: skip
    return ["anatomy", "choice", "figure", "median", "90 %", "hangs most on"], lines


def uncertain_csv(found: Sequence[Uncertain]) -> str:
    """Return every assumption's effect on every figure as CSV."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(
        ["anatomy", "choice", "figure", "assumption", "rank_correlation", "low_third", "high_third"]
    )
    for each in found:
        for figure in MEASURES:
            effects = zip(
                each.priors, each.rank_correlation(figure), each.moved(figure), strict=True
            )
            for prior, rank, (low, high) in effects:
                writer.writerow(
                    [each.anatomy, each.label, figure, prior.name, f"{rank:.4f}", f"{low:.4f}",
                     f"{high:.4f}"]
                )  # fmt: skip
    return text.getvalue()


_BAR_IN, _PANEL_IN = 0.2, 2.3


def uncertain_figure(found: Sequence[Uncertain], title: str) -> "Figure":
    """Draw a panel for each figure and choice: a bar for each assumption from the median of the
    draws with its lowest third to that with its highest, and a line at the median of all."""
    priors = found[0].priors
    figure = new_figure(
        2.8 + _PANEL_IN * len(STUDY_NAMES), len(found) * (0.9 + _BAR_IN * len(priors)) + 0.6
    )
    panels = figure.subplots(len(found), len(STUDY_NAMES), sharey=True, squeeze=False)
    for each, line in zip(found, panels, strict=True):
        for axes, (measure, name) in zip(line, STUDY_NAMES.items(), strict=True):
            low, high = each.moved(measure).T
            rises = [SERIES_COLORS[int(up)] for up in high >= low]
            axes.barh(range(len(priors)), high - low, left=low, height=0.7, color=rises)
            middle, first, last = each.interval(measure)
            axes.axvline(middle, color="black", lw=1)
            axes.axvspan(first, last, color="#eeeeee", zorder=0)
            plain(axes, f"{each.anatomy}, {each.label}" if axes is line[0] else "", name)
        line[0].set_yticks(range(len(priors)), [prior.name for prior in priors])
    panels[0][0].invert_yaxis()
    title += " (green: grows with the assumption, orange: falls)"
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, color=GREY)
    return figure


@dataclass(frozen=True, eq=False)
class StudyReport:
    """Table of a study, its plot, and files beside them."""

    heading: list[str]
    lines: list[list[str]]
    left: int  # columns of words
    note: str
    figure: Callable[[], "Figure"]
    files: dict[str, str]  # text of each by its name


def study_report(study: Study, beside: Path, rows: Sequence[StudyRow]) -> StudyReport:
    """Return what a study found: its choices, or with drawn fingers what they hang on."""
    if not study.uncertain:
        sums = study_sums(rows)
        heading, lines = study_table(sums)
        note = (
            "Medians and middle 90 % of fingers, of means over patterns: read wrongly, silent "
            "points, spikes of another class, misplaced ones. Best on: fingers on which no other "
            "choice is read with fewer errors. mA: mean total current of a slot."
        )
        return StudyReport(
            heading, lines, 2, note, lambda: study_figure(sums, STUDY_NAMES, study.title), {}
        )
    found = uncertain_sums(rows, *Grid(study, beside).drawn)
    heading, lines = uncertain_table(found)
    note = (
        f"Medians and middle 90 % of {study.uncertain} draws, each a mean over fingers. Hangs on: "
        "rank correlations; all of them are in hangs_on.csv, and drawn in study.png."
    )
    return StudyReport(
        heading, lines, 6, note, lambda: uncertain_figure(found, study.title),
        {"hangs_on.csv": uncertain_csv(found)},
    )  # fmt: skip
