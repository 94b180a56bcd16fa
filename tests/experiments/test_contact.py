"""Repeated measurements show together what touches, and how well."""

import contextlib

import numpy as np
import pytest

from smarttouch.base.errors import CalibrationError, LineLostError
from smarttouch.boards.reports import Impedance
from smarttouch.experiments.contact import (
    MOST_LOSSES,
    judge_contact,
    measure_contact,
)

from ..support.checks import raises


def measured(kohm, condition):
    return Impedance(np.array(kohm, float), tuple(condition), 0.5)


GOOD = ["good"] * 6


def test_medians_spreads_and_most_conditions():
    usual = ["good", "good", "open", "good", "short", "good"]
    once = ["good", "good", "open", "open", "short", "good"]
    runs = [
        measured([30, 31, np.inf, 30, 0.1, 29], usual),
        measured([32, 31, np.inf, np.inf, 0.1, 31], once),
        measured([34, 31, np.inf, 32, 0.2, 33], usual),
    ]
    found = judge_contact(runs)
    assert found.kohm.tolist() == [32, 31, np.inf, 32, 0.1, 31]
    assert found.condition == ("good", "good", "open", "good", "short", "good")
    assert found.broken == [2, 4]
    assert found.spread_kohm[0] == pytest.approx(1.4826 * 2)
    assert found.spread_kohm[1] == 0
    assert np.isnan(found.spread_kohm[[2, 3]]).all()
    assert found.sentence().startswith(
        "4 good, 1 open (electrodes 2), 1 short (electrodes 4) of 6 electrodes, the good ones 31"
    )


def test_what_they_disagree_on_is_unsure_and_not_masked():
    half = [measured([30] * 6, GOOD), measured([30] * 5 + [np.inf], [*GOOD[:5], "open"])]
    found = judge_contact(half)
    assert found.condition[5] == "unsure"
    assert found.broken == []


def test_what_goes_into_the_profile(profile, changed):
    masked = changed(profile, {"output.masked": (7, 20)})
    kohm = np.linspace(30, 40, 64)
    kohm[[3, 20]] = np.inf, 0.2
    condition = ["good"] * 64
    condition[3], condition[20] = "open", "short"
    found = judge_contact([measured(kohm, condition)])
    assert found.masked(masked) == [3, 7, 20]
    values = found.impedances(masked)
    usual = np.median(np.delete(kohm, [3, 20]))
    assert values[3] == values[20] == pytest.approx(usual, rel=1e-3)
    assert values[0] == 30


LIFTED = {"names": "finger"}


@pytest.mark.parametrize(("runs", "attributes"), [
    ([measured([np.inf] * 6, ["open"] * 6)], LIFTED),
    ([measured([30] * 6, GOOD), measured([np.inf] * 6, ["open"] * 6)], LIFTED),
    (
        [measured([30, 30] + [np.inf] * 4, ["good"] * 2 + ["open"] * 4)],
        {"value": 4},
    ),
    ([measured([30] * 6, ["unsure"] * 6)], {"value": 0}),
    ([measured([10 * 4**i] * 6, GOOD) for i in range(3)], {}),
])  # fmt: skip
def test_no_contact_is_one_sentence(runs, attributes):
    with raises(CalibrationError, **attributes):
        judge_contact(runs)


class Lossy:
    """A board that is lost at some of its measurements."""

    def __init__(self, lost_at):
        self.lost_at, self.opened, self.measured = lost_at, 0, 0

    @contextlib.contextmanager
    def __call__(self):
        self.opened += 1
        yield self

    def measure(self):
        self.measured += 1
        if self.measured in self.lost_at:
            raise LineLostError("gone")
        return self.measured


def test_a_lost_board_is_opened_again_and_measuring_continues():
    board = Lossy({2, 4})
    assert measure_contact(board, 4) == [1, 3, 5, 6]
    assert board.opened == 3


def test_a_board_that_is_lost_again_and_again_is_given_up():
    board = Lossy(set(range(1, 100)))
    with pytest.raises(LineLostError):
        measure_contact(board, 4)
    assert board.opened == MOST_LOSSES + 1
