"""The contract of drivers, run over the C core behind a pseudo-terminal and on a Cortex-M3."""

import time
from dataclasses import replace

import numpy as np
import pytest

from firmware.tests.scenes import random_table
from smarttouch.base.errors import BoardRestartedError
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from tests.boards.fresh import deliver, fresh_state, until
from tests.boards.test_contract import (
    AT_ANY_LINE,
    CLOSES,
    SENT,
    Contract,
    without_repeating,
)

from ..support.checks import raises


@without_repeating(
    SENT, AT_ANY_LINE, CLOSES,
    "test_a_newer_sequence_ends_a_repetition",
)  # fmt: skip
class TestFirmware(Contract):
    @pytest.fixture
    def url(self, start_firmware, tmp_path):
        # Time is what sequences claim.
        options = (f"--books={tmp_path}", "--ramp-ms=0")
        return "link:" + start_firmware(*options, output=self.output_kind)[1]


@pytest.mark.long
@pytest.mark.realtime
class TestCortexM3(TestFirmware):
    @pytest.fixture
    def url(self, start_cortex_m3, tmp_path):
        given = {"electrodes": self.electrodes, "output": self.output_kind, "ramp_ms": 0}
        return "link:" + start_cortex_m3(tmp_path, **given).name

    instants = 2

    def pulses(self):
        """Return its pulses; it shorts for longer than it is sent, while it is emulated."""
        return [replace(pulse, discharge_us=None) for pulse in super().pulses()]


def test_a_sudden_rise_is_refused(start_firmware, tmp_path, make_limits, make_sequence):
    """By a board with a ramp of its own: what the gate was made to overlook the board does not."""
    port = start_firmware(f"--books={tmp_path}")[1]
    with make_board(f"link:{port}", make_limits(), Output(kind="weighted")) as board:
        deliver(board, make_sequence(0))
        board.send(make_sequence(1))
        until(lambda: board.refused == 1)
        with raises(BoardRestartedError, names="board"):
            board.send(make_sequence(2))
        state = fresh_state(tmp_path)
    assert (state["slots"], state["violations"]) == (0, 1)


@pytest.mark.realtime
def test_a_board_whose_session_is_over_gets_its_kernels_in_another(start_firmware, make_limits):
    """The program may have been held up for longer than boards bear silence."""
    limits = make_limits()
    table = random_table(np.random.default_rng(0), 9, limits.electrodes)
    port = start_firmware()[1]
    with make_board(f"link:{port}", limits, Output(kind="weighted")) as board:
        packets = board.driver._session
        packets.beat = lambda: 0.01
        time.sleep(0.3)
        del packets.beat
        first = packets.number
        board.keep_kernels(table)
        assert packets.number != first
