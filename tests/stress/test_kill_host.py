"""A host is killed or stopped at random instants: its board is at zero, and nothing stays behind.

``nice pytest tests/stress/test_kill_host.py --runs 100 -n0 -s --timeout 0`` for the long form, with
figures: only that one is about how long it takes.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ..support.full import sample
from ..support.processes import Forked

KILLS = 2
WITHIN_MS = 100
pytestmark = pytest.mark.realtime
WATCHED_MS = 600
STEP_MS = 10
"""By so much the clock of an emulated board may run on while its process is kept from running."""


@pytest.mark.skipif(sys.platform != "linux", reason="it collects orphans as only Linux lets it")
@pytest.mark.parametrize(("kind", "how", "option"), sample([
    ("link", "kill", ""), ("etactilekit", "kill", ""), ("etactilekit", "stop", ""),
    ("kajimoto61", "kill", ""),
]))  # fmt: skip
def test_a_board_whose_host_is_gone_is_at_zero(kind, how, option, runs):
    kills = runs or KILLS
    script = Path(__file__).with_name("kill_host.py")
    with Forked(
        [sys.executable, script, kind, str(kills), f"--how={how}", f"--option={option}"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        said, wrong = process.communicate()
    assert process.returncode == 0, wrong
    found = json.loads(said)
    print(f"\n{found}")
    assert found["runs"] == kills
    assert (found["unsafe"], found["ports_kept"], found["processes_left"]) == (0, 0, 0)
    # A board that goes on pulses until it is not watched any more.
    assert found["worst_ms"] < 0.8 * WATCHED_MS
    if runs:
        assert found["driving"] > kills / 2
        assert found["worst_ms"] <= WITHIN_MS + STEP_MS
