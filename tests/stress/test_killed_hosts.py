"""Tests that a board is at zero after its host was killed, frozen or stopped, or got a signal.

Each case has one round, or two with ``--full``. ``nice pytest tests/stress --runs 100 -n0 -s
--timeout 0`` has 100 rounds, prints results, and also checks the time until zero.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from itertools import cycle, islice, product
from operator import itemgetter
from pathlib import Path

import pytest

from smarttouch.emulator.firmware_base import read_state

from ..boards.emulator_waits import fresh_state, starter
from ..support.full import WHOLE, sample
from ..support.processes import PROGRAM, emulator

pytestmark = pytest.mark.realtime
linux = pytest.mark.skipif(
    sys.platform != "linux", reason="only on Linux a process can adopt orphaned processes"
)
ELECTRODES = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
ROUNDS = 2 if WHOLE else 1
KITS = ("etactilekit 71adee2", "etactilekit newest")
WIRE_MS = {"kajimoto61": 13.0, "etactilekit newest": 8.0}
"""Longest time that these boards may take after a stop to finish a scan; others stop at once."""
LONGEST_START_S = 3.0
"""Largest random time from the start of a run to its signal."""
LONGEST_END_S = 30.0
WITHIN_MS, WATCHED_MS = 100, 600
STEP_MS = 10
"""Limit for the advance of an emulated board's clock while its process is delayed."""


def ended(cases, runs, folder):
    """Yield kind, way of ending and results of each case, from several runs of ``last_pulse.py``.

    Three cases run in parallel, because hosts mostly wait; with ``--runs``, only one. Each case has
    its own state folder, because a user may drive only two boards at once.
    """
    every, rounds = list(cases), runs or ROUNDS
    for first in range(0, len(every), at_once := 1 if runs else 3):
        with starter() as start:
            processes = {}
            for kind, how in every[first : first + at_once]:
                program = [sys.executable, Path(__file__).with_name("last_pulse.py")]
                user = os.environ | {"XDG_STATE_HOME": str(folder / f"{kind} {how}")}
                processes[kind, how] = start(
                    [*program, kind, how, str(rounds)], stderr=subprocess.PIPE, env=user
                )
            for case, process in processes.items():
                said, wrong = process.communicate()
                assert process.returncode == 0, wrong
                found = json.loads(said)
                print(f"\n{found}")
                assert (found["runs"], found["unsafe"], found["processes_left"]) == (rounds, 0, 0)
                yield *case, found


@linux
def test_a_board_whose_host_is_gone_is_at_zero(runs, tmp_path):
    cases = [
        ("link", "kill"),
        *product(["etactilekit"], ["kill", "freeze"]),
        ("kajimoto61", "kill"),
    ]
    for _, _, found in ended(sample(cases), runs, tmp_path):
        assert found["ports_kept"] == 0, found
        # If a board continued, its last pulse would be near the end of the observed time.
        assert found["worst_ms"] < 0.8 * WATCHED_MS, found
        if runs:
            assert found["pulsed"] > runs / 2, found
            assert found["worst_ms"] <= WITHIN_MS + STEP_MS, found


@linux
def test_no_slot_starts_after_a_stop(runs, tmp_path):
    # The driver of the kajimoto61 cannot measure.
    cases = [
        *product(["link", *KITS], ["measuring", "rising", "repeating"]),
        ("kajimoto61", "rising"), ("kajimoto61", "repeating"),
    ]  # fmt: skip
    for kind, _, found in ended(sample(cases, 4), runs, tmp_path):
        assert found["worst_ms"] <= WIRE_MS.get(kind, 0.0), found
        assert (found["violations"], found["driving"]) == (0, 0), found
        came = found["came"]
        # On a busy machine the call during the stop may raise LineLostError. All later calls raise
        # BoardStoppedError.
        assert came.get("LineLostError", 0) <= found["runs"], found
        refused = came["BoardStoppedError"] + came.get("LineLostError", 0)
        assert refused == 3 * found["runs"], found


def test_signals_end_runs_with_the_board_at_zero(runs, tmp_path):
    draw, kinds = random.Random(1), cycle(ELECTRODES)
    for number in range(0, runs or 3, 3):
        with starter() as start:
            # Each of three runs has its own state folder: a user may drive only two boards at once.
            due = []
            for kind in islice(kinds, 3):
                (books := tmp_path / f"books{number}{kind}").mkdir()
                board = start(emulator(kind, f"electrodes={ELECTRODES[kind]}", f"books={books}"))
                url = f"{kind}:{board.stdout.readline().strip()}"
                run = ["live", "--board", url, "--force", "fixed:1", "--intensity", "1"]
                user = os.environ | {"XDG_STATE_HOME": str(books)}
                host = start([PROGRAM, *run, "--seconds", "60"], stderr=subprocess.STDOUT, env=user)
                at_s = time.monotonic() + draw.uniform(0.0, LONGEST_START_S)
                due.append((at_s, host, SIGNALS[(number // 3 + len(due)) % 3], kind, books))
            for at_s, host, sign, *_ in sorted(due, key=itemgetter(0)):
                time.sleep(max(0.0, at_s - time.monotonic()))
                host.send_signal(sign)
            for _, host, _, kind, books in due:
                said, _ = host.communicate(timeout=LONGEST_END_S)
                assert "Traceback" not in said
                state = fresh_state(books)
                assert state["state"] != "driving", (kind, said)
                assert (state["unsafe"], state["violations"]) == (0, 0)
                assert fresh_state(books)["slots"] == read_state(books)["slots"] == state["slots"]
