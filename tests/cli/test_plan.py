"""On a real board a run begins at zero, whatever starts it."""

import sys

import pytest

from smarttouch.boards.board import may_touch_a_finger
from smarttouch.cli.plan import Plan
from smarttouch.errors import SmartTouchError
from smarttouch.primary import Mode

REAL, NONE = "link:/dev/ttyACM0", "emulator:"


@pytest.fixture
def keyboard(monkeypatch):
    """Return a setter of whether there is one."""
    return lambda there: monkeypatch.setattr(sys.stdin, "isatty", lambda: there, raising=False)


@pytest.mark.parametrize(
    ("board", "there", "level", "first", "most"),
    [
        (REAL, True, None, 0.0, 1.0),
        (REAL, True, 0.4, 0.0, 0.4),
        (REAL, False, 0.4, 0.4, 0.4),
        (NONE, True, None, 1.0, 1.0),
        (NONE, True, 0.4, 0.4, 1.0),
        (NONE, False, None, 1.0, 1.0),
        (NONE, False, 0.0, 0.0, 1.0),
    ],
)
def test_how_strong_it_begins_and_may_become(keyboard, board, there, level, first, most):
    keyboard(there)
    plan = Plan("page:x", board, Mode.RA, level=level)
    plan.require_a_level()
    assert (plan.first_level, plan.most) == (first, most)


def test_where_nobody_can_turn_it_up_somebody_says_how_strong(keyboard):
    keyboard(False)
    with pytest.raises(SmartTouchError, match="--intensity"):
        Plan("page:x", REAL, Mode.RA).require_a_level()


@pytest.mark.parametrize(
    ("url", "finger"),
    [
        ("link:x", True), ("kajimoto61:x", True), ("etactilekit:x", True), ("vibrators:x", True),
        ("emulator:", False), ("simulated:", False), ("memory:", False),
    ],
)  # fmt: skip
def test_which_boards_a_finger_may_be_on(url, finger):
    assert may_touch_a_finger(url) is finger


@pytest.mark.parametrize(
    "command",
    [
        ("live",), ("mouse",), ("read", "text:a"), ("color", "tone:30Hz,8um+press:0.5N"),
        ("experiment", "free", "--seconds", "1"), ("board", "test", "--seconds", "1"),
    ],
)  # fmt: skip
def test_no_command_drives_a_real_board_that_nobody_controls(program_here, command):
    board = ("link:/dev/nowhere",) if command[0] == "board" else ("--board", "link:/dev/nowhere")
    done = program_here(*command, *board)
    assert done.returncode == 2
    assert "there is no keyboard" in done.stderr
    assert done.stderr.count("\n") == 1
