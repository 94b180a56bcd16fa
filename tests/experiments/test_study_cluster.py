"""A study on a real Dask cluster, one of whose workers is killed on the way."""

import os
import signal
from pathlib import Path

import joblib
import pytest

from smarttouch.base.errors import SmartTouchError
from smarttouch.experiments.study_plan import Study
from smarttouch.experiments.study_run import on_cluster, run_study

from ..raising import raises
from ..whole import WHOLE

distributed = pytest.importorskip("distributed")

STUDY = Study(
    title="small",
    profiles=("smarttouch-4x4",),
    anatomies=("paper",),
    fingers=3,
    letters="LT",
)


@pytest.mark.skipif(not WHOLE, reason="long: with SMARTTOUCH_WHOLE=1, as in .ci/run")
def test_rows_are_the_same_when_a_worker_is_killed(tmp_path):
    with joblib.parallel_config("threading", n_jobs=1):
        here = run_study(STUDY, Path(), tmp_path / "here")
    killed = []

    async def not_again():
        """A killed worker is not replaced: the others do its work."""

    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:

        def kill(_done, _total):
            if not killed:
                killed.append(cluster.workers[0].pid)
                cluster.workers[0].instantiate = not_again
                os.kill(killed[0], signal.SIGKILL)

        with on_cluster(cluster.scheduler_address):
            there = run_study(STUDY, Path(), tmp_path / "there", progress=kill)
    assert killed
    assert there == here
    tables = [(tmp_path / each / "rows.csv").read_bytes() for each in ("here", "there")]
    assert tables[0] == tables[1]


def test_a_missing_scheduler_is_an_error(monkeypatch):
    monkeypatch.setattr("smarttouch.experiments.study_run._ANSWERS_WITHIN_S", 0.2)
    with (
        raises(SmartTouchError, value="tcp://127.0.0.1:1"),
        on_cluster("tcp://127.0.0.1:1"),
    ):
        pass


def test_missing_dask_is_an_error(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with raises(SmartTouchError, names="extra"), on_cluster("tcp://a:1"):
        pass
