"""Commands on boards that a finger may be on."""

import pytest

from smarttouch.boards.open import may_touch_a_finger

from ..boards.fresh import fresh_state
from .conftest import refused, says

pytestmark = pytest.mark.usefixtures("patient_boards")


@pytest.mark.parametrize(("url", "finger"), [
    ("link:x", True), ("kajimoto61:x", True), ("etactilekit:x", True),
    ("emulator:", False), ("simulated:", False), ("memory:", False),
])  # fmt: skip
def test_which_boards_a_finger_may_be_on(url, finger):
    assert may_touch_a_finger(url) is finger


@pytest.mark.parametrize("command", [
    ("live",), ("live", "texture:"), ("read", "text:a"),
    ("live", "vibration:tone:30Hz,8um+press:0.5N"),
    ("experiment", "run", "free", "--seconds", "1"), ("devices", "test", "--seconds", "1"),
])  # fmt: skip
def test_no_command_drives_a_real_board_that_nobody_controls(program_here, command):
    board = ("link:/dev/nowhere",) if command[0] == "devices" else ("--board", "link:/dev/nowhere")
    about = "keyboard" if command[0] == "devices" else "intensity"
    says(names=about)(refused(program_here(*command, *board)))


@pytest.mark.parametrize(
    "command",
    [
        ("live",), ("read", "text:a"), ("live", "texture:"),
        ("live", "vibration:tone:30Hz,8um+press:0.5N"),
        ("experiment", "run", "detection"),
        ("experiment", "run", "free", "--seconds", "1", "--profile", "kajimoto-61"),
        ("devices", "test", "--seconds", "1", "--current-ma", "0.5"),
        ("calibrate", "thresholds", "--output", "mine.toml", "--electrodes", "5"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_no_command_drives_a_real_board_whose_finger_nobody_measures(
    start_at_a_terminal, start_emulator, command
):
    _, port, books = start_emulator(61, "kajimoto61")
    url = f"kajimoto61:{port}"
    board = (url,) if command[0] == "devices" else ("--board", url)
    process, _ = start_at_a_terminal(*command, *board)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--force" in errors
    assert fresh_state(books)["max_current_ma"] == 0
