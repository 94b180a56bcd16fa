"""Boards of one source refuse recharge phases."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output


@pytest.mark.parametrize("url", ["memory:", "simulated:"])
@pytest.mark.parametrize("kind", ["three-state", "one-against-all"])
def test_a_board_of_one_source_refuses(url, kind, make_limits, make_sequence):
    with make_board(url, make_limits(), Output(kind=kind)) as board:
        assert not board.capabilities.recharges
        board.send(make_sequence(0))
        scan = make_sequence(1, period_us=20_000)
        with pytest.raises(BoardError):
            board.send(replace(scan, recharge_ua=np.zeros(8, np.int16), recharge_us=200))
        assert board.report().slots == 0
        board.send(scan)
