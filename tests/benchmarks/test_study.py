"""Studies: rows of 1, 2 and 4 Dask workers, and what a finger costs."""

from pathlib import Path

import joblib
import pytest

from smarttouch.experiments.study_plan import Grid, Study, rows_of_letters
from smarttouch.experiments.study_run import on_cluster, run_study
from smarttouch.physiology.anatomy import load_anatomy

STUDY = Study(
    title="small", profiles=("smarttouch-4x4",), anatomies=("paper",), fingers=8, letters="LT"
)


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_rows_are_the_same_on_any_number_of_workers(benchmark, quick, tmp_path, workers):
    distributed = pytest.importorskip("distributed")
    if quick and workers != 2:
        pytest.skip("quick: two workers stand for all")
    with joblib.parallel_config("threading", n_jobs=1):
        here = run_study(STUDY, Path(), tmp_path / "here")
    with (
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        on_cluster(cluster.scheduler_address),
    ):
        there = benchmark.pedantic(
            run_study, (STUDY, Path(), tmp_path / "there"), rounds=1, iterations=1
        )
    assert there == here
    tables = [(tmp_path / each / "rows.csv").read_bytes() for each in ("here", "there")]
    assert tables[0] == tables[1]


@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_a_finger_with_26_letters_and_two_scans(benchmark, quick, anatomy):
    letters = "LT" if quick else Study(title="all").letters
    study = Study(title="scans", scans=("points", "auto"), letters=letters)
    grid = Grid(study, Path())
    (name,) = study.profiles
    shown = grid.letters(name)
    profile = grid.profiles[name]
    rows = benchmark(rows_of_letters, profile, shown, load_anatomy(anatomy), anatomy, 1)
    assert len(rows) == 2 * len(letters)
