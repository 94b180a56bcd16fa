"""Signals to runs at random instants: how soon the board is at zero, and the run over."""

import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from forked import KINDS, Emulated, start_host, stuck_terminal, wait_for_end

LONGEST_START_S = 4.0
"""A run drives its board well before that."""
NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def one(draw, number, kind, stuck, folder):
    """Start a run, end it by a signal, and return what came of it."""
    board = Emulated(kind)
    run = ["live", "--board", board.url, "--force", "fixed:1", "--seconds", "60"]
    ends = None
    if stuck:
        *ends, name = stuck_terminal(b"+" * 20)
        host = start_host(run, folder, terminal=name)
    else:
        run += ["--intensity", "1"]
        host = start_host(run, folder, out=folder / "out")
    after_s = draw.uniform(0.0, LONGEST_START_S)
    time.sleep(after_s)
    board.flag()
    os.kill(host, number)
    code, took_s = wait_for_end(host, 15.0)
    if code is None:
        os.kill(host, signal.SIGKILL)
        os.waitpid(host, 0)
    for end in ends or ():
        os.close(end)
    return {
        "signal": signal.Signals(number).name, "board": kind, "stuck": stuck,
        "after_s": after_s, "code": code, "took_s": took_s, **board.ended(),
    }  # fmt: skip


def main(count, stuck, seed):
    """Send so many signals, to so many runs with a stuck terminal; print what came of each."""
    with tempfile.TemporaryDirectory() as folder:
        found = [
            one(
                random.Random(1000 * seed + each), NUMBERS[each % 3],
                list(KINDS)[(each + each // 3) % 3], each < stuck, Path(folder),
            )
            for each in range(count)
        ]  # fmt: skip
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
