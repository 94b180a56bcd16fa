"""Assumptions are drawn from their priors, and a study of draws shows what its figures hang on."""

from pathlib import Path

import joblib
import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.experiments.study_plan import Grid, Study
from smarttouch.experiments.study_priors import drawn_anatomy, hypercube, load_priors
from smarttouch.experiments.study_run import run_study
from smarttouch.experiments.uncertainty import Uncertain, study_report
from smarttouch.physiology.anatomy import list_anatomies, load_anatomy

from ..raising import raises

PRIORS = load_priors()


def test_each_range_is_covered_evenly_and_always_alike():
    values = hypercube(PRIORS, 40)
    assert np.array_equal(values, hypercube(PRIORS, 40))
    for prior, column in zip(PRIORS, values.T, strict=True):
        bounds = [prior.value(part) for part in np.linspace(0, 1, 41)]
        assert np.histogram(column, bounds)[0].tolist() == [1] * 40


@pytest.mark.parametrize("name", list_anatomies())
def test_a_draw_is_an_anatomy_within_the_priors(name):
    usual = load_anatomy(name)
    for values in hypercube(PRIORS, 100):
        drawn = drawn_anatomy(usual, PRIORS, values)
        given = {prior.name: value for prior, value in zip(PRIORS, values, strict=True)}
        assert drawn.ra.depth_mm == given["depth of RA, mm"]
        times = given["density of PC, times"]
        assert drawn.pc.density_per_cm2 == pytest.approx(times * usual.pc.density_per_cm2)
        assert drawn.contact_mm2 == given["contact at 1 N, mm²"]
        if name.startswith("paper"):
            assert (drawn.ra.endings, drawn.sai.branch_spread_mm) == (1, 0)
        else:
            assert drawn.ra.endings == round(10 * given["endings of an axon, times"])
        assert bool(drawn.layers) == ("layered" in name)
        if drawn.layers:
            assert drawn.layers[0].thickness_mm == given["stratum corneum, mm"]
            assert drawn.layers[3] == usual.layers[3]


@pytest.mark.parametrize(("keys", "low", "about"), [
    ("ra.deep", 1, "keys"), ("layers.9.thickness_mm", 1, "keys"), ("ra", 1, "ra"),
    ("title", 1, "title"), ("ra.depth_mm", 3, "low"), ("ra.depth_mm", -1, "depth_mm"),
])  # fmt: skip
def test_priors_that_make_no_sense_are_refused(tmp_path, keys, low, about):
    path = tmp_path / "mine.toml"
    line = f'[[priors]]\nname = "x"\nsource = "x"\nkeys = ["{keys}"]\nlow = {low}\nhigh = 2\n'
    path.write_text(line)
    with raises(ProfileError, key=lambda found: about in found):
        for values in hypercube(priors := load_priors(path), 3):
            drawn_anatomy(load_anatomy("paper-layered"), priors, values)


def test_a_figure_hangs_on_what_makes_it():
    values = hypercube(PRIORS, 60)
    figures = {"up": values[:, 2] ** 3, "down": np.exp(-values[:, 5]), "none": np.zeros(60)}
    figures["up"][7] = np.nan
    found = Uncertain("paper", "RA", PRIORS, values, figures)
    for name, index, sign in (("up", 2, 1), ("down", 5, -1)):
        ranks, moved = found.rank_correlation(name), np.diff(found.moved(name))[:, 0]
        assert ranks[index] == pytest.approx(sign)
        assert np.abs(np.delete(ranks, index)).max() < 0.5
        assert sign * moved[index] == np.abs(moved).max()
        middle, low, high = found.interval(name)
        assert low < middle < high
    assert not found.rank_correlation("none").any()


def test_an_uncertain_study_has_intervals_and_what_they_hang_on(tmp_path):
    study = Study(
        title="small", profiles=("smarttouch-4x4",), anatomies=("paper",), fingers=2, letters="LT",
        levels=("profile", "own"), uncertain=4,
    )  # fmt: skip
    with joblib.parallel_config("threading", n_jobs=1):
        rows = run_study(study, Path(), tmp_path)
    assert len(rows) == 4 * 2 * 2 * 2
    assert list(dict.fromkeys(row.anatomy for row in rows)) == [f"paper#{k}" for k in (1, 2, 3, 4)]
    assert {row.finger for row in rows} == {*range(1, 9)}
    found = study_report(study, Path(), rows)
    assert [line[1] for line in found.lines] == ["profile"] * 4 + ["own"] * 4
    assert len(found.files["hangs_on.csv"].splitlines()) == 1 + 2 * 4 * len(PRIORS)
    assert len(found.figure().axes) == 8
    assert Grid(study, Path()).drawn[1].shape == (4, len(PRIORS))
