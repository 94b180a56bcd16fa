"""Findings as series for a chart, as JSON, and as text."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from smarttouch.plotting.discrimination import Judged, Series
from smarttouch.psychophysics.fitting.bootstrap import Bounded
from smarttouch.psychophysics.fitting.table import Table
from smarttouch.psychophysics.fitting.verdict import Finding, what_was_said

_CURVE_POINTS = 301


def as_series(table: Table, findings: Sequence[Finding]) -> Series:
    """Return the chart's series of one file."""
    first = findings[0]
    said = what_was_said(first.answers, first.model)
    return Series(table.name, table.unit, tuple(map(_judged, findings)), first.model.share, said)


def as_figures(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the JSON figures of each standard; an end that is not known is null."""
    return [
        {
            "standard": each.answers.standard or None,
            "presented": each.answers.presented,
            "answered": each.answers.answered,
            "function": each.model.shape.value,
            "logarithmic": each.model.logarithmic,
            "at": each.model.share,
            "threshold": _ends(each.threshold),
            "weber": _ends(each.weber),
            "middle": _ends(each.middle),
            "lower": _ends(each.lower),
            "lower_weber": _ends(each.lower_weber),
            "spread": each.fit and each.fit.spread,
            "slope": each.fit and each.fit.slope,
            "lapse": each.fit and each.fit.lapse,
            "guess": each.fit and each.fit.guess,
            "deviance": each.fit and each.fit.deviance,
            "goodness": each.goodness,
            "verdict": each.verdict,
            "notes": each.notes,
        }
        for each in findings
    ]


def threshold_rows(findings: Sequence[Finding], compares: bool) -> list[list[str]]:
    """Return a heading, and a row of words for each finding that has a threshold."""
    share = findings[0].model.share if findings else 0.0
    heading = ["n", f"{share:.0%} at", "slope", "lapse", "p"]
    if compares:
        heading = ["standard", *heading[:2], "Weber", "lower", "middle", *heading[2:]]
    rows = [heading]
    for each in findings:
        assert each.fit is not None
        goodness = "" if each.goodness is None else f"{each.goodness:.2f}"
        cells = [str(each.answers.answered), in_words(each.threshold)]
        if compares:
            lower = "" if each.lower_weber is None else f"{each.lower_weber.value:.0%}"
            cells += [in_percent(each.weber), lower, f"{each.fit.at(0.5):.3g}"]
            cells.insert(0, f"{each.answers.standard:g}")
        rows.append([*cells, f"{each.fit.slope:.2g}", f"{each.fit.lapse:.2f}", goodness])
    return rows


def in_words(found: Bounded | None) -> str:
    """Return a figure with its interval as text; an end that is not known is an ellipsis."""
    if found is None:
        return ""
    low, high = (f"{each:.3g}" if math.isfinite(each) else "…" for each in found[1:])
    return f"{found.value:.3g} ({low}–{high})"


def in_percent(found: Bounded | None) -> str:
    """Return a part with its interval, in percent."""
    if found is None:
        return ""
    low, high = (f"{round(100 * each)}" if math.isfinite(each) else "…" for each in found[1:])
    return f"{found.value:.0%} ({low} to {high})"


def _judged(found: Finding) -> Judged:
    counts = found.answers.counts()
    curve = None
    if found.fit is not None:
        x = found.model.axis(counts.stimulus)
        x = x[np.isfinite(x)]
        stimulus = found.model.stimulus(np.linspace(x[0], x[-1], _CURVE_POINTS))
        curve = np.stack([stimulus, found.fit(stimulus)])
    return Judged(
        found.answers.standard,
        *counts,
        curve=curve,
        threshold=found.threshold,
        lower=found.lower,
        beyond=found.beyond,
    )


def _ends(found: Bounded | None) -> dict[str, float | None] | None:
    if found is None:
        return None
    return {name: each if math.isfinite(each) else None for name, each in found._asdict().items()}
