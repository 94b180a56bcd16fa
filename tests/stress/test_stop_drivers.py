"""No driver lets current flow after a stop has returned, whatever it does and whoever stops it.

A few rounds of each by default; ``SMARTTOUCH_STOP_ROUNDS=500`` makes it as many on each driver.
"""

import json
import os
import random
import subprocess
import sys
import threading
import time
from itertools import product
from pathlib import Path

import pytest

from smarttouch.base.errors import BoardStoppedError, SequenceLateError
from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import one_each
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..forks import Forked
from ..whole import sample

ROUNDS = int(os.environ.get("SMARTTOUCH_STOP_ROUNDS", "2"))
LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.8)
LATEST_S = 0.15
KITS = ("etactilekit 71adee2", "etactilekit newest")
WIRE_MS = {"kajimoto61": 13.0, "etactilekit newest": 8.0}
"""What a board still makes of what it has: a packet's scan, or that under way; else nothing."""
pytestmark = pytest.mark.timeout(120 + 30 * ROUNDS)


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform != "linux", reason="it collects orphans as only Linux lets it")
@pytest.mark.parametrize(("kind", "action"), sample([
    # A kajimoto61 does not measure.
    *product(["link", *KITS], ["measuring", "rising", "repeating"]),
    ("kajimoto61", "rising"), ("kajimoto61", "repeating"),
]))  # fmt: skip
def test_no_slot_starts_after_a_stop(kind, action, record_property):
    command = [sys.executable, Path(__file__).with_name("stop_drivers.py"), kind, action]
    with Forked([*command, str(ROUNDS)], stdout=subprocess.PIPE) as process:
        said, _ = process.communicate()
    assert process.returncode == 0
    found = json.loads(said)
    record_property("found", found)
    assert found["worst_ms"] <= WIRE_MS.get(kind, 0.0), found
    assert (found["wrong"], found["driving"]) == (0, 0), found
    came = found["came"]
    # On a busy machine an answer may be too late for what is under way, never for what comes after.
    assert came.get("LineLostError", 0) <= ROUNDS, found
    assert came["BoardStoppedError"] + came.get("LineLostError", 0) == 3 * ROUNDS, found


@pytest.mark.parametrize("kind", ["memory:", "simulated:"])
@pytest.mark.parametrize("times", [1, 500], ids=["rising", "repeating"])
def test_no_board_of_this_process_goes_on_after_a_stop(kind, times):
    draw = random.Random(f"{kind} {times}")
    for _ in range(ROUNDS):
        came = []

        def drive(board, came=came):
            step = zero = 0
            while not came:
                part = min(1.0, (step - zero) / 50)
                sequence = one_each(
                    LIMITS, int(2000 * part), 50, part, step * 10_000_000 + 1, cathodic=True
                )
                step += 1
                try:
                    board.send(sequence, times)
                except SequenceLateError:
                    # On a busy computer: it begins again at zero.
                    zero = step
                except BoardStoppedError as error:
                    came.append(error)

        with make_board(kind, LIMITS) as board:
            driver = threading.Thread(target=drive, args=(board,))
            driver.start()
            time.sleep(draw.uniform(0, LATEST_S))
            board.stop()
            before = board.acknowledged, board.report()
            driver.join(30)
            assert len(came) == 1
            assert (board.acknowledged, board.report()) == before
            with pytest.raises(BoardStoppedError):
                board.measure()
