"""Threshold for each standard, or the reason why it has none; tables and figures of results."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from smarttouch.experiments.answer_file import Answers, AnswerTable
from smarttouch.experiments.psychometric import Array, Bounded, Counts, Fit, Model, fit
from smarttouch.views.figure_style import GREY, SERIES_COLORS, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEWEST_ANSWERS = 15
MOST_UNANSWERED = 0.5
"""Largest allowed share of unanswered trials. With a larger share, the answers may be biased."""
SAME_INTERVAL = 0.95
"""Largest allowed share of answers that name the same interval. A larger share means guessing."""
FLAT = 0.02  # largest p value with which answers count as dependent on the comparison
_FALLING = -2.58  # a trend is falling if its z score is below this, as for 1 of 200 random trends
_CURVE_POINTS = 301
_BOUNDED = ("threshold", "weber", "middle", "lower", "lower_weber")


@dataclass(frozen=True, eq=False)
class Finding:
    """Result of the fit for one standard."""

    answers: Answers
    model: Model
    fit: Fit | None  # None if no function could be fitted
    verdict: str | None = None  # reason why there is no threshold; None if there is one

    @property
    def standard(self) -> float:
        """Standard of the comparisons; 0 if there is none."""
        return self.answers.standard

    @property
    def success_name(self) -> str:
        """Name of a success: *judged higher*, *judged more*, *felt* or *correct*."""
        if self.model.guess == "equal":
            return "judged higher" if self.standard else "judged more"
        return "felt" if self.model.guess in ("free", 0) else "correct"

    @cached_property
    def counts(self) -> Counts:
        """Trials and successes at each comparison."""
        return self.answers.counts()

    @cached_property
    def curve(self) -> Array | None:
        """Stimuli and fitted shares of successes, (2, L); None without a fit."""
        if self.fit is None:
            return None
        x = self.model.axis(self.counts.stimulus)
        x = x[np.isfinite(x)]
        stimulus = self.model.stimulus(np.linspace(x[0], x[-1], _CURVE_POINTS))
        return np.stack([stimulus, self.fit(stimulus)])

    @cached_property
    def threshold(self) -> Bounded | None:
        """Stimulus at which the share of successes equals `Model.share`."""
        return self._at(self.model.level)

    @cached_property
    def middle(self) -> Bounded | None:
        """Stimulus at which the cumulative normal F is 0.5. If `Model.guess` is "equal", this is
        the point of subjective equality."""
        return self._at(0.5)

    @cached_property
    def lower(self) -> Bounded | None:
        """Lower threshold: the stimulus at which the cumulative normal F is 1 minus `Model.level`.

        None if this threshold is below all comparisons, or if `Model.guess` is not "equal".
        """
        if self.model.guess != "equal":
            return None
        bounds = self._at(1 - self.model.level)
        return None if bounds is None or bounds.value < self.answers.comparison.min() else bounds

    @property
    def weber(self) -> Bounded | None:
        """Weber fraction: upper threshold divided by standard, minus 1 (paper, Fig. 16, bottom)."""
        return self._relative(self.threshold)

    @property
    def lower_weber(self) -> Bounded | None:
        """Negative Weber fraction: lower threshold divided by standard, minus 1."""
        return self._relative(self.lower)

    def _at(self, part: float) -> Bounded | None:
        return None if self.verdict or self.fit is None else self.fit.bounded(part)

    def _relative(self, bounds: Bounded | None) -> Bounded | None:
        standard = self.answers.standard
        if bounds is None or not standard:
            return None
        return Bounded(*(bound / standard - 1 for bound in bounds))


def judge_answers(answers: Answers, model: Model) -> Finding:
    """Fit the answers for one standard, or state why they do not determine a threshold."""

    def none(why: str, found: Fit | None = None) -> Finding:
        return Finding(answers, model, found, why)

    if unusable := _unusable(answers):
        return none(unusable)
    counts = answers.counts()
    low, high = float(counts.stimulus[0]), float(counts.stimulus[-1])
    total, successes = int(counts.n.sum()), int(counts.k.sum())
    success = Finding(answers, model, None).success_name
    if successes == total:
        return none(f"{success} in all {total} answers: a threshold can only be below {low:.4g}")
    if successes == 0:
        return none(f"{success} in 0 of {total} answers: a threshold can only be above {high:.4g}")
    share = successes / total
    if len(counts.stimulus) == 1:
        why = f"{success} in {share:.0%} of {total} answers, all of them at comparison {low:.4g}"
        return none(f"{why}: test several comparisons")
    found = fit(counts, model, answers.standard)
    if _chance_of_flat(found, _guessing(answers, model)) > FLAT:
        if _trend(counts) < _FALLING:
            return none(
                f"higher comparisons were {success} less often than lower ones: check whether the "
                "keys, or the comparison and the standard, are swapped"
            )
        return none(
            f"answers do not depend on the comparison: {success} in {share:.0%} of {total} "
            f"answers, without a clear rise from {low:.4g} to {high:.4g}: run more trials"
        )
    threshold = found.bounded(model.level).value
    low, high = (float(bound) for bound in model.stimulus(found.ends))
    if not low <= threshold <= high:
        end = f"above {high:.4g}" if threshold > high else f"below {low:.4g}"
        why = f"the threshold (at {model.share:.0%}) lies {end}: test comparisons beyond this value"
        return none(why, found)
    return Finding(answers, model, found)


def _unusable(answers: Answers) -> str | None:
    """Return the reason why answers cannot be fitted, or None."""
    answered, presented = answers.answered, answers.presented
    if answered < (1 - MOST_UNANSWERED) * presented:
        return f"only {answered} of {presented} trials were answered"
    if answered < FEWEST_ANSWERS:
        return f"{answered} answers are too few: at least {FEWEST_ANSWERS} are needed"
    chosen = answers.chosen()
    if sum(chosen) >= FEWEST_ANSWERS and max(chosen) > SAME_INTERVAL * sum(chosen):
        word = "first" if chosen[0] > chosen[1] else "second"
        words = f"interval was chosen {max(chosen)} of {sum(chosen)} times"
        return f"the {word} {words}, regardless of the stimulus"
    return None


def _chance_of_flat(fitted: Fit, share: float) -> float:
    """Return the p value of a likelihood-ratio test of the fit against a constant share.

    The statistic has a chi-squared distribution with two degrees of freedom (threshold and spread).
    """
    n, k = fitted.counts.n, fitted.counts.k
    constant = float(k.sum() * math.log(share) + (n - k).sum() * math.log1p(-share))
    return math.exp(min(0.0, constant - float(fitted.log_likelihoods.max())))


def _guessing(answers: Answers, model: Model) -> float:
    """Return the share of successes of a participant who guesses.

    If a success is a correct answer, the share is known. Otherwise return the observed share. This
    share makes `_chance_of_flat` a weaker test: adaptive procedures keep the share nearly constant.
    """
    if not isinstance(model.guess, str) and model.guess > 0:
        return model.guess
    if model.guess == "equal" and answers.comparison.min() >= answers.standard > 0:
        return 0.5
    return float(np.nanmean(answers.success))


def _trend(counts: Counts) -> float:
    """Return the Cochran-Armitage trend statistic (1955) of successes over ranked comparisons."""
    rank = np.arange(len(counts.n)) * 1.0
    total, share = counts.n.sum(), counts.k.sum() / counts.n.sum()
    rank -= (counts.n @ rank) / total
    return float(counts.k @ rank / math.sqrt(share * (1 - share) * (counts.n @ rank**2)))


def as_json(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the results for each standard as JSON values; an infinite end is null."""
    return [
        {
            "standard": finding.answers.standard or None,
            "presented": finding.answers.presented,
            "answered": finding.answers.answered,
            "logarithmic": finding.model.logarithmic,
            "at": finding.model.share,
            **{name: _ends(getattr(finding, name)) for name in _BOUNDED},
            **{
                name: finding.fit and float(getattr(finding.fit.parameters, name)[0])
                for name in ("spread", "lapse", "guess")
            },
            "verdict": finding.verdict,
        }
        for finding in findings
    ]


def threshold_rows(findings: Sequence[Finding], compares: bool) -> list[list[str]]:
    """Return a heading, and a row of text for each finding. Each finding must have a fit."""
    share = findings[0].model.share if findings else 0.0
    heading = ["n", f"{share:.0%} at", "spread", "lapse"]
    if compares:
        heading = ["standard", *heading[:2], "Weber", "lower", "middle", *heading[2:]]
    rows = [heading]
    for finding in findings:
        assert finding.fit is not None
        cells = [str(finding.answers.answered), in_words(finding.threshold)]
        if compares:
            lower = "" if finding.lower_weber is None else f"{finding.lower_weber.value:.0%}"
            cells += [
                f"{finding.weber.value:.0%}" if finding.weber else "",
                lower,
                f"{finding.fit.bounded(0.5).value:.3g}",
            ]
            cells.insert(0, f"{finding.answers.standard:g}")
        spread, lapse = finding.fit.parameters.spread[0], finding.fit.parameters.lapse[0]
        rows.append([*cells, f"{spread:.2g}", f"{lapse:.2f}"])
    return rows


def in_words(bounds: Bounded | None) -> str:
    """Return a value with its interval as text, with an ellipsis for an infinite end."""
    if bounds is None:
        return ""
    low, high = (f"{bound:.3g}" if math.isfinite(bound) else "…" for bound in bounds[1:])
    return f"{bounds.value:.3g} ({low}–{high})"


def _ends(bounds: Bounded | None) -> dict[str, float | None] | None:
    if bounds is None:
        return None
    return {
        name: bound if math.isfinite(bound) else None for name, bound in bounds._asdict().items()
    }


_TICKS = (0.25, 0.33, 0.5, 0.67, 0.8, 1, 1.25, 1.5, 2, 3, 4)  # comparison divided by standard
Series = tuple[AnswerTable, Sequence[Finding]]  # answers of one file, and the findings from them


def discrimination_figure(series: Sequence[Series]) -> "Figure":
    """Draw one panel for each series, with a psychometric curve for each standard.

    If all findings have standards, a panel below shows thresholds relative to standards.
    """
    compares = all(finding.standard for _, findings in series for finding in findings)
    figure = new_figure(max(5.2, 4.6 * len(series)), 5.6 if compares else 3.2)
    grid = figure.add_gridspec(1 + compares, len(series))
    for index, (table, findings) in enumerate(series):
        axes = figure.add_subplot(grid[0, index])
        for column, finding in enumerate(findings):
            unit, label = finding.standard or 1.0, f"{finding.standard:g} {table.unit}".rstrip()
            _draw_shares(axes, finding, unit, SERIES_COLORS[column % 6], label)
        axes.axhline(findings[0].model.share, color=GREY, lw=0.5, ls=":")
        if compares:
            axes.axvline(1.0, color=GREY, lw=0.5)
            axes.set_xscale("log")
            low, high = axes.get_xlim()
            ticks = [tick for tick in _TICKS if low <= tick <= high]
            axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes.minorticks_off()
            axes.legend(frameon=False, fontsize=7, title="standard", title_fontsize=7)
        stimulus = "comparison / standard" if compares else f"stimulus{_unit(series)}"
        plain(axes, table.name, stimulus, f"share {findings[0].success_name}")
    if compares:
        _draw_thresholds(figure.add_subplot(grid[1, :]), series)
    return figure


def _draw_shares(axes: Any, finding: Finding, unit: float, color: str, label: str) -> None:
    """Draw the fitted curve, the interval of the threshold, and a dot for each share of successes.
    Dots become larger with more answers, up to 10. The abscissa is the stimulus over ``unit``."""
    stimulus, n, k = finding.counts
    size = 8 + 2 * np.minimum(n, 10)
    axes.scatter(stimulus / unit, k / n, size, color=[color], label=label, lw=0, zorder=3)
    axes.set_ylim(-0.04, 1.04)
    if finding.curve is None:
        return
    x, share = finding.curve
    axes.plot(x / unit, share, "--" if finding.threshold is None else "-", color=color, lw=1.2)
    if finding.threshold is not None:
        value, low, high = finding.threshold
        ends = np.clip([low, high], stimulus[0], stimulus[-1]) / unit
        axes.plot(ends, [np.interp(value, x, share)] * 2, color=color, lw=3, alpha=0.4)


def _draw_thresholds(axes: Any, series: Sequence[Series]) -> None:
    axes.axhline(0, color=GREY, lw=0.6)
    for index, (table, findings) in enumerate(series):
        color = SERIES_COLORS[index % 6]
        aside = 1 + 0.01 * (index - (len(series) - 1) / 2)
        for name, style in (("threshold", "o-"), ("lower", "o:")):
            rows = [
                (finding.standard, *(getattr(finding, name) or [np.nan] * 3))
                for finding in findings
            ]
            standard, *bounded = np.array(rows).T
            value, low, high = np.array(bounded) / standard - 1
            # Draw an infinite end as far from the value as 0 is: at 0, or at twice the value.
            reach = np.array([value - low, high - value])
            reach = np.where(np.isinf(reach), np.abs(value), reach).tolist()
            axes.errorbar(standard * aside, value, reach, fmt=style, color=color, ms=4, lw=1,
                          capsize=2.5, label=f"{table.name}, {name}")  # fmt: skip
    standards = sorted({finding.standard for _, findings in series for finding in findings})
    axes.set_xticks(standards, [f"{standard:g}" for standard in standards])
    axes.legend(frameon=False, fontsize=7, ncols=len(series))
    share = series[0][1][0].model.share
    plain(axes, "", f"standard{_unit(series)}", f"Weber fraction at {share:.0%}")


def _unit(series: Sequence[Series]) -> str:
    return f" ({series[0][0].unit})" if series[0][0].unit else ""
