"""Psychometric fits agree with hand calculations; a verdict says why there is no threshold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.answer_file import AnswerTable, usual_model
from smarttouch.experiments.findings import (
    discrimination_figure,
    judge_answers,
)
from smarttouch.experiments.procedures import constant_stimuli, ratio_pairs
from smarttouch.experiments.psychometric import Counts, Model, Parameters, fit
from smarttouch.views.figure_style import save

from ..support.checks import numbers_in, raises
from .simulated import Subject, answer_all, as_answers, ask_all, of_counts

MODELS = [
    Model(), Model(guess=0.5), Model(guess=0.0, at=0.75), Model(guess="free"),
    Model(guess=0.04, logarithmic=False),
]  # fmt: skip


def counts_of(stimulus, n, k):
    return Counts(*(np.asarray(each, float) for each in (stimulus, n, k)))


@st.composite
def data(draw):
    stimulus = draw(st.lists(st.integers(1, 400), min_size=2, max_size=9, unique=True).map(sorted))
    n = [draw(st.integers(1, 30)) for _ in stimulus]
    return counts_of(stimulus, n, [draw(st.integers(0, each)) for each in n])


@given(data(), st.sampled_from(MODELS))
def test_any_answers_give_estimates_in_their_intervals_that_rise_with_the_share(counts, model):
    found = fit(counts, model)
    shares = found(np.linspace(counts.stimulus[0] / 3, 3 * counts.stimulus[-1], 50))
    assert ((shares >= 0) & (shares <= 1)).all()
    assert (np.diff(shares) >= -1e-12).all()
    bounded = np.array([found.bounded(part) for part in (0.1, 0.5, 0.75, 0.9)])
    assert (bounded[1:] >= bounded[:-1]).all()
    value, low, high = bounded.T
    assert ((low <= value) & (value <= high) & np.isfinite(value)).all()


def test_two_points_by_hand():
    """Success in 1/4 of trials at 0 and 3/4 at 2 gives midpoint 1, spread 1 / norm.ppf(3/4)."""
    z = norm.ppf(0.75)
    model = Model(guess=0.0, logarithmic=False, most_lapses=0.0)
    found = fit(counts_of([0, 2], [2000, 2000], [500, 1500]), model)
    assert found.bounded(0.5).value == pytest.approx(1.0, abs=0.01)
    assert found.parameters.spread[0] == pytest.approx(1 / z, rel=0.01)
    assert found.bounded(0.75).value == pytest.approx(2.0, abs=0.02)
    assert found(np.array([0.0, 1.0, 2.0])) == pytest.approx([0.25, 0.5, 0.75], abs=0.01)
    # Standard error of the midpoint, which is the mean of the two quantiles, in stimulus units.
    deviation = math.sqrt(0.25 * 0.75 / 2000) / norm.pdf(z) / math.sqrt(2) / z
    half = (found.bounded(0.5).high - found.bounded(0.5).low) / 2
    assert half == pytest.approx(1.96 * deviation, rel=0.05)


def test_what_nothing_at_all_says_is_the_guess():
    model = Model(guess="free")
    x = model.axis([0.0, 1.0])
    parameters = Parameters(*(np.array([each]) for each in (0.0, 1.0, 0.02, 0.13)))
    assert model.probability(x, parameters)[0, 0] == 0.13
    counts = counts_of([0, 1, 2, 4, 8], [40] * 5, [8, 8, 22, 38, 40])
    assert fit(counts, model).parameters.guess[0] == pytest.approx(0.2, abs=0.04)


def test_an_interval_without_an_end():
    counts = counts_of([20, 25, 30, 40, 50], [3] * 5, [0, 1, 1, 1, 2])
    found = fit(counts, Model()).bounded(0.99)
    assert found.low < found.value < math.inf
    assert math.isinf(found.high)


@pytest.mark.parametrize(("arguments", "value"), [
    ({"guess": 1.0}, 1.0),
    ({"guess": -0.1}, -0.1),
    ({"guess": 0.5, "at": 0.4}, 0.4),
    ({"at": 1.0}, 1.0),
    ({"guess": 0.5, "most_lapses": 0.3}, 0.5),
])  # fmt: skip
def test_contradictions(arguments, value):
    with raises(ExperimentError, value=value):
        replace(Model(), **arguments)


def session(answers, standard=30.0, repetitions=10, seed=0):
    """Simulate a session; ``answers(condition, trial)`` returns the answer to a trial."""
    procedure = constant_stimuli(ratio_pairs([standard]), repetitions, seed=seed)
    shown = ask_all(procedure)
    return as_answers(shown, [answers(each, n) for n, each in enumerate(shown)])


def verdict(answers):
    found = judge_answers(answers, usual_model([answers]))
    assert found.verdict
    assert found.threshold is found.weber is found.middle is found.lower is None
    return found


NO_THRESHOLD = {
    "first": (lambda each, n: each.comparison_interval == 1, ["first", 100, 100]),
    "second, but once": (
        lambda each, n: each.comparison_interval == 2 or n == 3, ["second", 99, 100]
    ),
    "in turn": (
        lambda each, n: (n % 2 == 0) == (each.comparison_interval == 1), ["depend", 48, 100, 15, 60]
    ),
    "all felt": (of_counts([1, 2, 3], [10] * 3, [10] * 3), ["in all", 30, 1]),
    "none felt": (of_counts([1, 2, 3], [10] * 3, [0] * 3), ["in 0 of", 0, 30, 3]),
    "few answers": (
        lambda each, n: None if n % 5 else each.comparison > 30, ["answered", 20, 100]
    ),
    "no answers": (lambda each, n: None, ["answered", 0, 100]),
    "few trials": (
        session(lambda each, n: each.comparison > 30, repetitions=1), ["too few", 10, 15]
    ),
    "one comparison": (of_counts([3], [40], [17]), ["several comparisons", 42, 40, 3]),
}  # fmt: skip


@pytest.mark.parametrize("name", NO_THRESHOLD)
def test_no_threshold(name):
    answers, said = NO_THRESHOLD[name]
    found = verdict(session(answers) if callable(answers) else answers)
    words = [each for each in said if isinstance(each, str)]
    assert all(each in found.verdict for each in words)
    assert numbers_in(found.verdict) == said[len(words) :]


def test_upside_down():
    subject = Subject(30.0, 0.25, 0.5)
    random = np.random.default_rng(1)
    swapped = session(lambda each, n: random.random() > subject.probability(each.comparison))
    assert "are swapped" in verdict(swapped).verdict


def test_beyond_the_range():
    subject = Subject(90.0, 0.8)
    answers = answer_all(constant_stimuli(ratio_pairs([30.0]), 60), subject.probability, 2)
    found = verdict(answers)
    assert numbers_in(found.verdict) == [75, 60]
    assert found.fit.bounded(0.75).value > 60
    low = of_counts([5, 6, 7, 8, 10], [60] * 5, [40, 44, 50, 55, 60])
    assert "below 5" in verdict(low).verdict


def test_one_sided_and_of_two_intervals_are_tested_against_guessing():
    """With a standard or two choices, shares that stay near 75 % are not mistaken for guesses."""
    stimulus = [32.0, 33, 34, 35, 36]
    share = of_counts(stimulus, [12] * 5, [8, 9, 9, 9, 10], standard=30.0)
    assert judge_answers(share, usual_model([share])).verdict is None
    guessed = of_counts(stimulus, [12] * 5, [6, 5, 7, 6, 7], standard=30.0)
    assert "depend" in verdict(guessed).verdict
    right = of_counts(stimulus, [12] * 5, [8, 9, 9, 9, 10], alternatives=2)
    assert judge_answers(right, usual_model([right])).verdict is None
    felt = of_counts(stimulus, [12] * 5, [8, 9, 9, 9, 10])
    assert "depend" in verdict(felt).verdict


@given(data(), st.sampled_from([0.0, 30.0]), st.sampled_from([None, "equal", "free", 0.5]))
def test_any_answers_have_a_threshold_or_a_reason(counts, standard, guess):
    answers = of_counts(*(np.asarray(each, int) for each in counts), standard)
    found = judge_answers(answers, usual_model([answers], guess=guess))
    assert (found.verdict is None) == (found.threshold is not None)
    if found.threshold is not None:
        assert found.threshold.low <= found.threshold.high


def test_which_model():
    frequency = of_counts([20, 40], [1, 1], [0, 1], standard=30.0)
    assert usual_model([frequency]) == Model(guess="equal")
    side = of_counts([-2, 2], [1, 1], [0, 1])
    assert usual_model([side]) == Model(guess="equal", logarithmic=False)
    assert usual_model([of_counts([1, 2], [1, 1], [0, 1])]) == Model(guess=0.0)
    assert usual_model([of_counts([0, 2], [1, 1], [0, 1])]) == Model(guess="free")
    assert usual_model([of_counts([1, 2], [1, 1], [0, 1], alternatives=26)]).guess == 1 / 26
    assert usual_model([frequency], 0.5, 0.8) == Model(guess=0.5, at=0.8)
    assert Model(guess=0.5, at=0.8).share == pytest.approx(0.8)


def test_two_modes_in_a_figure(tmp_path):
    """The figure shows the thresholds of a good participant, but none of one who only guesses."""
    good = Subject(36.0, 0.25).probability
    procedure = constant_stimuli(ratio_pairs([30.0]), 30)
    answers = answer_all(procedure, good, 3), session(lambda each, n: n % 2 == 0, 60.0)
    found = [judge_answers(each, usual_model([each])) for each in answers]
    series = [(AnswerTable(name, "Hz", ()), found) for name in ("RA", "PC")]
    figure = discrimination_figure(series)
    ra, pc, thresholds = figure.axes
    assert (ra.get_title(loc="left"), pc.get_title(loc="left")) == ("RA", "PC")
    assert [each.get_text() for each in ra.get_legend().get_texts()] == ["30 Hz", "60 Hz"]
    dots = np.asarray(ra.collections[0].get_offsets())
    assert dots[:, 0] == pytest.approx(found[0].counts.stimulus / 30)
    assert dots[:, 1] == pytest.approx(found[0].counts.k / found[0].counts.n)
    weber = found[0].weber
    points, lower, other, _ = (each.lines[0].get_xydata() for each in thresholds.containers)
    assert points[0] == pytest.approx([30, weber.value], rel=0.01)
    assert lower[0] == pytest.approx([30, found[0].lower_weber.value], rel=0.01)
    assert points[0, 0] < 30 < other[0, 0]
    assert np.isnan(points[1, 1])
    (segment, *_) = thresholds.containers[0].lines[2][0].get_segments()
    assert segment[:, 1] == pytest.approx([weber.low, weber.high])
    assert "75%" in thresholds.get_ylabel()
    save(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_a_figure_without_standards():
    answers = of_counts([0, 1, 2, 3], [20] * 4, [1, 6, 14, 20])
    found = judge_answers(answers, usual_model([answers]))
    (axes,) = discrimination_figure([(AnswerTable("one", "mA", ()), [found])]).axes
    assert "(mA)" in axes.get_xlabel()
    (interval,) = [line.get_xydata() for line in axes.lines if line.get_linewidth() == 3]
    assert interval[:, 0] == pytest.approx([found.threshold.low, found.threshold.high])
