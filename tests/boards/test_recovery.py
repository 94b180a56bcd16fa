"""A lost board is started anew, also if it is lost again meanwhile."""

import pytest

from smarttouch.boards.recovery import TIMES, start_anew
from smarttouch.errors import (
    BoardError,
    BoardStoppedError,
    LineLostError,
    OtherDeviceError,
    SilentBoardError,
)

LOST = LineLostError("the line broke")


def failing(*errors):
    """Return a start that fails so, one after another, and then does not."""
    left = list(errors)

    def start():
        if left:
            raise left.pop(0)

    return start, left


@pytest.mark.parametrize("kind", [LineLostError, SilentBoardError])
@pytest.mark.parametrize("again", range(TIMES))
def test_what_is_lost_again_meanwhile_is_begun_again(kind, again):
    start, left = failing(*[kind("again")] * again)
    start_anew(start, LOST)
    assert left == []


def test_the_first_loss_is_told_of_where_it_does_not_come_back():
    start, left = failing(*[LineLostError("again")] * (TIMES + 1))
    with pytest.raises(LineLostError) as error:
        start_anew(start, LOST)
    assert (error.value, len(left)) == (LOST, 1)


@pytest.mark.parametrize("kind", [BoardError, OtherDeviceError, BoardStoppedError])
def test_what_trying_again_does_not_mend_is_tried_once(kind):
    start, left = failing(kind("no"), kind("no"))
    with pytest.raises(BoardError) as error:
        start_anew(start, LOST)
    assert len(left) == 1
    assert isinstance(error.value, BoardStoppedError) == (kind is BoardStoppedError)
