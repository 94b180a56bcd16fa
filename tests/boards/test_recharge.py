"""Boards of one source refuse recharge phases."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.recharge import RechargeRules, add_recharge

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
@pytest.mark.parametrize("kind", ["three-state", "one-against-all"])
def test_a_board_of_one_source_refuses(url, kind, make_limits, recharged):
    with make_board(url, make_limits(), Output(kind=kind)) as board:
        assert not board.capabilities.recharges
        board.send(recharged(0))
        with pytest.raises(BoardError):
            board.send(recharged(1))
        assert board.report().slots == 0
        board.send(replace(recharged(1), recharge_ua=None, recharge_us=0))
