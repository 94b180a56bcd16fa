"""Commands on boards that a finger may be on."""

import pytest

from smarttouch.boards.open import may_touch_a_finger

from .conftest import refused, says


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
    about = "keyboard" if command[0] == "board" else "intensity"
    says(about=about, problem="missing")(refused(program_here(*command, *board)))
