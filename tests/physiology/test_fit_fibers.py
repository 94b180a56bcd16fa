"""Fits of driving functions: what they are judged on is not what they were fitted to."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.physiology.driving_function import FIBERS, load_driving
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.finger_afferents import axon_path_points
from smarttouch.physiology.membrane import thresholds_ma

from ..fit_fibers import fiber_cases, fiber_fit, fit_fibers, mrg
from ..raising import raises

along_mm, cases = fiber_cases.along_mm, fiber_cases.cases


@pytest.mark.parametrize("ending", [True, False])
def test_cases_share_no_kernel_with_those_to_judge_on(profile, bank, ending):
    seen, unseen = (cases(profile, bank, ending, held_out) for held_out in (False, True))
    patterns = [
        {tuple(row) for row in np.abs(each.current_ma)[each.group != "single"]}
        for each in (seen, unseen)
    ]
    assert [len(each) for each in patterns] == [20, 20]
    assert not patterns[0] & patterns[1]
    assert np.linalg.norm(seen.direction, axis=1) == pytest.approx(1)
    assert np.all(seen.direction[:, 2] >= np.cos(np.radians(30)) - 1e-9) == ending


def test_nodes_lie_to_both_sides_or_below_the_ending():
    assert along_mm("through", 0.5, 1.0) == pytest.approx([-1, -0.5, 0, 0.5, 1])
    assert along_mm("passive", 0.5, 1.0) == pytest.approx([0, 0.5, 1])


def test_a_small_fit_is_better_than_the_activating_function(profile, bank):
    seen, unseen = (
        each[np.arange(len(each.group)) % 9 == 0]
        for each in (cases(profile, bank, False, held_out) for held_out in (False, True))
    )
    fit = fit_fibers._fit_one("trunk", "through", 200.0, seen, unseen)
    assert fit.held_out["all"].cases == len(unseen.group)
    assert fit.held_out["all"].tenth < 0.1 < fit.activating.tenth
    table = json.loads(json.dumps(fit_fibers.as_json([fit])))
    assert table["trunk"]["through"]["200"]["along"] == pytest.approx(fit.driving.along, rel=1e-4)
    heading, row = fit_fibers.error_rows([fit])
    assert len(heading) == len(row)


def test_endings_that_are_offered():
    assert fit_fibers.ends_of("fingertip") == ("through", "active", "passive")
    assert fit_fibers.ends_of("mrg") == ("through", "active")


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.SAI])
def test_thresholds_of_bent_branches_that_no_fit_has_seen(profile, bank, afferent):
    """Courses of a branched finger, under kernels, against the cable model."""
    one = Finger(profile, 1, "branched").populations[afferent]
    like = replace(FIBERS["fingertip"], end="passive")
    ending = one.axon_path_mm[:, 0, :2]
    picked = np.flatnonzero((np.abs(ending) < 7).all(axis=1))[::40][:16]
    points = axon_path_points(one, picked, 75, like.internode_mm)
    potentials = []
    fields = potential_mv(profile, points)
    for index, (branch, potential) in enumerate(zip(picked, fields, strict=True)):
        away = np.linalg.norm(profile.electrodes.position_mm - ending[branch], axis=1)
        kernel = bank.kernels((Afferent.RA, Afferent.SAI)[index % 2])[away.argmin()]
        potentials.append(potential @ kernel)
    driving = load_driving("fingertip", "passive", 200.0)
    drive = driving.drive(np.array(potentials)[..., None])[..., 0].max(axis=1)
    cable = thresholds_ma(potentials, like, 200.0, 0.6 / drive)
    error = fiber_fit.threshold_error(drive, cable)
    assert error.cases == len(picked)
    assert error.median < 0.1
    assert error.worst < 0.25


def test_a_run_of_the_reference_model_goes_on_where_it_stopped(
    profile, bank, tmp_path, monkeypatch
):
    asked = []

    class Model:
        along_mm = np.linspace(-15, 15, 61)

        def __init__(self, end):
            assert end == "through"

        def thresholds_ma(self, fields, width_us, near_ma):
            if len(asked) == 2:
                raise KeyboardInterrupt
            asked.append(len(fields))
            return 1.2 * near_ma

    monkeypatch.setattr(mrg, "MrgFiber", Model)
    some = cases(profile, bank, False, False)
    some = some[np.arange(len(some.group)) < 25]
    fiber = replace(FIBERS["mrg"], end="through")
    potential = some.potential_mv(along_mm("through", fiber.internode_mm, 15.0))
    run = (fiber, 200.0, some, potential, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        fit_fibers._mrg_thresholds(*run)
    asked.pop()
    found = fit_fibers._mrg_thresholds(*run)
    assert asked == [10, 5]
    assert np.array_equal(found, fit_fibers._mrg_thresholds(*run))
    assert len(found) == 25


def test_the_reference_model_without_its_packages(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfibers", None)
    with raises(DesignError, names="pyfibers"):
        mrg.MrgFiber("through")
