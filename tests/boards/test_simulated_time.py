"""Time of ``simulated:``, which passes by time stamps."""

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.open import make_board

from ..raising import raises

SECOND = 10**9
SILENT, FAINT, STRONG = 0.0, 0.29, 1.0


@pytest.fixture
def send(make_limits, make_sequence, monkeypatch):
    """Return what sends sequences, each a time and an intensity, to a board that checks the rise.

    The gate lets all of them pass, see ``claimed_time``.
    """
    monkeypatch.setattr("smarttouch.emulator.link_rules.RAMP_MS", 500)
    with make_board("simulated:", make_limits()) as board:

        def send(*given):
            for time_s, intensity in given:
                if intensity == SILENT:
                    board.close_level()
                sequence = make_sequence(
                    int(intensity > 0), intensity=intensity, time_ns=int(time_s * SECOND)
                )
                # With current for long enough to rise.
                board.send(sequence, times=1 + 60 * (intensity == FAINT))
            return board

        yield send


def test_its_firmware_checks_the_rise(send):
    with raises(BoardError, names="board", value=2) as error:
        send((0, SILENT), (1, STRONG))
    assert "rule 18 (rise)" in str(error.value)


def test_a_level_stays_open_for_a_while(send):
    assert send((0, SILENT), (1, FAINT), (2, STRONG), (16, STRONG)).acknowledged == 4


@pytest.mark.parametrize("later_s", [19, 10_000])
def test_a_gap_closes_the_level(send, later_s):
    """However long it is, it costs little."""
    board = send((0, SILENT), (1, FAINT), (2, STRONG))
    with raises(BoardError, names="board", value=4):
        send((later_s, STRONG))
    assert board.driver._packets.session.sent < 1000
