"""Studies: rows do not depend on interruptions or workers; wrong plans are refused."""

import os
import signal
from pathlib import Path

import joblib
import pytest

from smarttouch.base.errors import ProfileError, SmartTouchError
from smarttouch.experiments.simulated_study import (
    ROWS_FILE,
    Study,
    from_csv,
    load_study,
    on_cluster,
    run_study,
    study_sums,
    study_table,
)

from ..support.checks import raises
from ..support.full import sample

PLANS = sorted(Path(__file__).parents[2].glob("examples/studies/[!_]*.toml"))
SMALL = Study(
    title="small", profiles=("smarttouch-4x4",), anatomies=("paper",), fingers=3, letters="LT",
    modes=("RA", "SAI"), intensities=(0.5, 1.0),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def one_process():
    with joblib.parallel_config("threading", n_jobs=1):
        yield


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(SMALL, Path(), tmp_path_factory.mktemp("whole"))


def test_each_finger_gets_each_letter_in_each_choice(rows):
    assert len(rows) == 3 * 2 * 2 * 2
    assert len({(row.finger, row.mode, row.intensity, row.pattern) for row in rows}) == len(rows)
    assert [row.finger for row in rows] == sorted(row.finger for row in rows)
    full, half = (
        [row for row in rows if row.intensity == each and row.mode == "RA"] for each in (1.0, 0.5)
    )
    assert sum(row.spikes for row in full) > sum(row.spikes for row in half)
    assert full[0].total_ma == pytest.approx(2 * half[0].total_ma, rel=0.01)


def test_a_study_goes_on_where_it_was_interrupted(rows, tmp_path):
    def interrupt(done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(SMALL, Path(), tmp_path, progress=interrupt)
    assert not (tmp_path / ROWS_FILE).exists()
    made = []
    assert run_study(SMALL, Path(), tmp_path, progress=lambda *done: made.append(done)) == rows
    assert made == [(3, 3)]
    assert from_csv((tmp_path / ROWS_FILE).read_text()) == rows


@pytest.mark.parametrize("broken", ["finger,letter\n1,L\n", 'finger\n"' + 200_000 * "x"])
def test_a_broken_part_is_made_again(tmp_path, broken):
    one = SMALL.model_copy(update={"fingers": 1, "intensities": (1.0,), "modes": ("RA",)})
    found = run_study(one, Path(), tmp_path)
    (part,) = (tmp_path / "parts").iterdir()
    part.write_text(broken)
    assert run_study(one, Path(), tmp_path) == found


def test_the_summary_is_by_choice(rows):
    found = study_sums(rows)
    assert [each.label for each in found] == ["RA, 0.5", "RA, 1", "SAI, 0.5", "SAI, 1"]
    heading, lines = study_table(found)
    assert {len(line) for line in lines} == {len(heading)}


@pytest.mark.parametrize("plan", sample(PLANS, 4), ids=lambda each: each.stem)
def test_the_plans_of_the_documentation_s_tables_run(tmp_path, plan):
    study = load_study(plan)
    short = study.model_copy(update={"fingers": 1, "letters": "T"})
    rows = run_study(short, plan.parent, tmp_path)
    assert {row.anatomy for row in rows} == set(short.anatomies)


@pytest.mark.parametrize(("text", "about"), [
    ('title = "x"\nfinger = 3', "finger"),
    ('title = "x"\nletters = "ABC1"', "letters"),
    ('title = "x"\nletters = ""', "letters"),
    ('title = "x"\nintensities = [2.0]', "intensities"),
    ("fingers = 2", "title"),
    ('title = "x"\nlevels = ["own"]', "levels"),
    ('title = "x"\nuncertain = 9', "uncertain"),
])  # fmt: skip
def test_a_plan_that_makes_no_sense_is_refused(tmp_path, text, about):
    plan = tmp_path / "study.toml"
    plan.write_text(text)
    with raises(ProfileError, key=about):
        load_study(plan)


@pytest.mark.long
def test_rows_are_the_same_when_a_worker_is_killed(tmp_path):
    distributed = pytest.importorskip("distributed")
    with joblib.parallel_config("threading", n_jobs=1):
        here = run_study(SMALL, Path(), tmp_path / "here")
    killed = []

    async def not_again():
        """Do not replace the killed worker, so that the other worker does its tasks."""

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:

        def kill(_done, _total):
            if not killed:
                killed.append(cluster.workers[0].pid)
                cluster.workers[0].instantiate = not_again
                os.kill(killed[0], signal.SIGKILL)

        with on_cluster(cluster.scheduler_address):
            there = run_study(SMALL, Path(), tmp_path / "there", progress=kill)
    assert killed
    assert there == here
    tables = [(tmp_path / each / "rows.csv").read_bytes() for each in ("here", "there")]
    assert tables[0] == tables[1]


def test_a_missing_scheduler_is_an_error(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("smarttouch.experiments.simulated_study._CONNECT_TIMEOUT_S", 0.2)
    with raises(SmartTouchError, value="tcp://127.0.0.1:1"), on_cluster("tcp://127.0.0.1:1"):
        pass
