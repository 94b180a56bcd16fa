"""``smarttouch stop`` against runs that are starting or driving: none survives it."""

import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from forked import KINDS, Emulated, start_host, wait_for_end

AT_ONCE = 2
"""Runs that start against one stop: as many as the budget of a user lets open."""
WITHIN_S = 1.5
RUNS_FOR_S = 6.0
"""Longest time from the last start to the stop: a run drives its board well before that."""
IMPORTING_S = 0.8


def one(draw, folder):
    """Start some runs at random instants before a stop; return what came of each, and of it."""
    state = Path(tempfile.mkdtemp(dir=folder))
    boards = [Emulated(draw.choice(list(KINDS))) for _ in range(AT_ONCE)]
    starts = sorted(draw.uniform(0.0, WITHIN_S) for _ in boards)
    begin, hosts = time.monotonic(), []
    for board, start_s in zip(boards, starts, strict=True):
        time.sleep(max(0.0, begin + start_s - time.monotonic()))
        run = ["live", "--board", board.url, "--force", "fixed:1", "--intensity", "1"]
        run += ["--seconds", "60"]
        delay_s = draw.uniform(0.0, IMPORTING_S)
        hosts.append(start_host(run, state, out=state / "out", delay_s=delay_s))
    # Later than the last, by more than the system's steps of the time when it was started.
    time.sleep(draw.uniform(0.02, RUNS_FOR_S))
    for board in boards:
        board.flag()
    code, took_s = wait_for_end(start_host(["stop"], state, out=state / "stop"), 15.0)
    found, said = [], (state / "stop").read_text()
    for board, host in zip(boards, hosts, strict=True):
        own, _ = wait_for_end(host, 2.0)
        if own is None:
            os.kill(host, signal.SIGKILL)
            os.waitpid(host, 0)
        found.append(
            {"board": board.kind, "code": own, "stop": code, "stop_s": took_s, "said": said}
        )
    return [each | board.ended() for each, board in zip(found, boards, strict=True)]


def main(count, seed):
    """Let so many runs start against stops; print what came of each."""
    with tempfile.TemporaryDirectory() as folder:
        rounds = range(-(-count // AT_ONCE))
        found = [run for each in rounds for run in one(random.Random(1000 * seed + each), folder)]
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
