"""Signals at random instants: ``--runs 300 --timeout 0`` for many."""

import random
import signal
import subprocess
import time
from itertools import cycle

import pytest

from smarttouch.emulator.firmware import read_state

from ..boards.fresh import fresh_state, starter
from ..support.processes import PROGRAM, emulator

ELECTRODES = {"link": 64, "kajimoto61": 61, "etactilekit": 32}
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
LONGEST_START_S, LONGEST_END_S = 3.0, 30.0
"""A run drives its board well before the one, and has ended before the other."""


@pytest.mark.realtime
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
