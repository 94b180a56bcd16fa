"""Recharge phases on their way to boards: those that can make them do, others refuse."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.open import make_board
from smarttouch.emulator.firmware import read_recharges, read_slots, read_state
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import RechargeRules, add_recharge
from tests.boards.fresh import deliver

pytestmark = pytest.mark.usefixtures("patient_boards")

RULES = RechargeRules(np.full(8, 119, np.int64), 10_000, ScanTiming())
BOARDS = ("memory:", "simulated:", "emulator:")


@pytest.fixture
def recharged(make_sequence):
    """Return a maker of sequences, the first silent, with the phase that brings all back."""

    def make(step=1, slots=3):
        scan = make_sequence(step, slots=slots, period_us=20_000)
        return add_recharge(scan, np.zeros(8, np.int64), RULES)

    return make


@pytest.mark.parametrize("url", BOARDS)
def test_a_board_of_weighted_outputs_makes_them(url, make_limits, recharged, tmp_path):
    """The books of an emulator show what flowed."""
    options = {"books": tmp_path} if url == "emulator:" else {}
    with make_board(url, make_limits(), Output(kind="weighted"), **options) as board:
        assert board.capabilities.recharges
        deliver(board, *map(recharged, range(4)))
        report = board.report()
    assert (report.sequences, report.slots, report.violations) == (4, 9, 0)
    assert report.max_charge_uc == pytest.approx(0.07, rel=0.01)
    # Whole µA that take back no more than there is leave less than 2 µA times the width.
    planned = recharged()
    assert report.max_net_charge_uc <= 3 * 2e-6 * planned.recharge_us
    if not options:
        return
    state, phases = read_state(tmp_path), read_recharges(tmp_path)
    assert phases["current_ua"].tolist() == [planned.recharge_ua.tolist()] * 3
    assert (state["recharges"], state["slots"], len(read_slots(tmp_path))) == (3, 9, 9)
    assert np.abs(state["passed_uc"]).max() <= 3 * 2e-6 * planned.recharge_us < 0.003
    without_uc = 3e-6 * 100 * planned.current_ua.sum(axis=0)
    assert np.abs(without_uc).max() > 0.1


@pytest.mark.parametrize("url", BOARDS)
@pytest.mark.parametrize("kind", ["three-state", "one-against-all"])
def test_a_board_of_one_source_refuses(url, kind, make_limits, recharged):
    with make_board(url, make_limits(), Output(kind=kind)) as board:
        assert not board.capabilities.recharges
        board.send(recharged(0))
        with pytest.raises(BoardError):
            board.send(recharged(1))
        assert board.report().slots == 0
        board.send(replace(recharged(1), recharge_ua=None, recharge_us=0))
