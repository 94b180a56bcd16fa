"""No driver lets current flow after a stop has returned, whatever it does and whoever stops it.

A few rounds of each by default; ``--runs 500 --timeout 0`` makes it as many on each driver.
"""

import json
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from ..support.full import sample
from ..support.processes import Forked

ROUNDS = 2
KITS = ("etactilekit 71adee2", "etactilekit newest")
WIRE_MS = {"kajimoto61": 13.0, "etactilekit newest": 8.0}
"""What a board still makes of what it has: a packet's scan, or that under way; else nothing."""


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform != "linux", reason="it collects orphans as only Linux lets it")
@pytest.mark.parametrize(("kind", "action"), sample([
    # A kajimoto61 does not measure.
    *product(["link", *KITS], ["measuring", "rising", "repeating"]),
    ("kajimoto61", "rising"), ("kajimoto61", "repeating"),
]))  # fmt: skip
def test_no_slot_starts_after_a_stop(kind, action, record_property, runs):
    rounds = runs or ROUNDS
    command = [sys.executable, Path(__file__).with_name("stop_drivers.py"), kind, action]
    with Forked([*command, str(rounds)], stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()
    assert process.returncode == 0
    found = json.loads(said)
    record_property("found", found)
    assert found["worst_ms"] <= WIRE_MS.get(kind, 0.0), found
    assert (found["wrong"], found["driving"]) == (0, 0), found
    came = found["came"]
    # On a busy machine an answer may be too late for what is under way, never for what comes after.
    assert came.get("LineLostError", 0) <= rounds, found
    assert came["BoardStoppedError"] + came.get("LineLostError", 0) == 3 * rounds, found
