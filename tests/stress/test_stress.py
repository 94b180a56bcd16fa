"""Whenever a host is killed, frozen, stopped or gets a signal, its board is at zero, and nothing
stays behind.

A few rounds of each by default; ``nice pytest tests/stress --runs 100 -n0 -s --timeout 0`` for the
long form, with figures: only that one is about how long it takes.
"""

import json
import random
import signal
import subprocess
import sys
import time
from itertools import cycle, product
from pathlib import Path

import pytest

from smarttouch.emulator.firmware import read_state

from ..boards.fresh import fresh_state, starter
from ..support.full import sample
from ..support.processes import PROGRAM, Forked, emulator

pytestmark = pytest.mark.realtime
linux = pytest.mark.skipif(
    sys.platform != "linux", reason="it collects orphans as only Linux lets it"
)
ELECTRODES = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ROUNDS = 2
KITS = ("etactilekit 71adee2", "etactilekit newest")
WIRE_MS = {"kajimoto61": 13.0, "etactilekit newest": 8.0}
"""What a stopped board still makes of what it has: a packet's scan, or that under way; else
nothing."""
LONGEST_START_S, LONGEST_END_S = 3.0, 30.0
"""A run drives its board well before the one, and has ended before the other."""
WITHIN_MS, WATCHED_MS = 100, 600
STEP_MS = 10
"""By so much the clock of an emulated board may run on while its process is kept from running."""


def ended(kind, how, rounds):
    """Return what came of boards whose hosts were ended so often."""
    command = [sys.executable, Path(__file__).with_name("hosts.py"), kind, how, str(rounds)]
    with Forked(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        said, wrong = process.communicate()
    assert process.returncode == 0, wrong
    found = json.loads(said)
    print(f"\n{found}")
    assert (found["runs"], found["unsafe"], found["processes_left"]) == (rounds, 0, 0)
    return found


@linux
@pytest.mark.parametrize(("kind", "how"), sample([
    ("link", "kill"), ("etactilekit", "kill"), ("etactilekit", "freeze"), ("kajimoto61", "kill"),
]))  # fmt: skip
def test_a_board_whose_host_is_gone_is_at_zero(kind, how, runs):
    found = ended(kind, how, runs or ROUNDS)
    assert found["ports_kept"] == 0
    # A board that goes on pulses until it is not watched any more.
    assert found["worst_ms"] < 0.8 * WATCHED_MS
    if runs:
        assert found["pulsed"] > runs / 2
        assert found["worst_ms"] <= WITHIN_MS + STEP_MS


@linux
@pytest.mark.parametrize(("kind", "action"), sample([
    # A kajimoto61 does not measure.
    *product(["link", *KITS], ["measuring", "rising", "repeating"]),
    ("kajimoto61", "rising"), ("kajimoto61", "repeating"),
]))  # fmt: skip
def test_no_slot_starts_after_a_stop(kind, action, runs):
    rounds = runs or ROUNDS
    found = ended(kind, action, rounds)
    assert found["worst_ms"] <= WIRE_MS.get(kind, 0.0), found
    assert (found["violations"], found["driving"]) == (0, 0), found
    came = found["came"]
    # On a busy machine an answer may be too late for what is under way, never for what comes after.
    assert came.get("LineLostError", 0) <= rounds, found
    assert came["BoardStoppedError"] + came.get("LineLostError", 0) == 3 * rounds, found


def test_signals_end_runs_with_the_board_at_zero(runs, tmp_path):
    draw, kinds = random.Random(1), cycle(ELECTRODES)
    for number in range(runs or 3):
        kind, books = next(kinds), tmp_path / f"books{number}"
        books.mkdir()
        with starter() as start:
            board = start(emulator(kind, f"electrodes={ELECTRODES[kind]}", f"books={books}"))
            url = f"{kind}:{board.stdout.readline().strip()}"
            run = ["live", "--board", url, "--force", "fixed:1", "--intensity", "1"]
            host = start([PROGRAM, *run, "--seconds", "60"], stderr=subprocess.STDOUT)
            time.sleep(draw.uniform(0.0, LONGEST_START_S))
            host.send_signal(SIGNALS[(number + number // 3) % 3])
            said, _ = host.communicate(timeout=LONGEST_END_S)
            assert "Traceback" not in said
            state = fresh_state(books)
            assert state["state"] != "driving", (kind, said)
            assert (state["unsafe"], state["violations"]) == (0, 0)
            assert fresh_state(books)["slots"] == read_state(books)["slots"] == state["slots"]
