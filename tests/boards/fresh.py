"""Waiting for what an emulator's process does, for as long as a busy machine takes."""

import contextlib
import subprocess
import time

from smarttouch.emulator.firmware import STATE_FILE, read_state

from ..support.processes import Forked
from ..support.runs import HANGS_S, until

__all__ = ["HANGS_S", "until"]

ENDED_S = 1.0
"""Whoever writes nothing for that long has ended."""


def deliver(board, *sequences, times=1):
    """Send sequences, each once the board has done with the one before."""
    for sequence in sequences:
        board.send(sequence, times)
        board.drain()


@contextlib.contextmanager
def starter():
    """Give a starter of processes, forks if nothing else is said; in the end they are killed."""
    started = []

    def start(command, kind=Forked, **options):
        process = kind(command, **{"stdout": subprocess.PIPE, "text": True} | options)
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def fresh_state(folder):
    """Return the state in an emulator's books once all that came before this call is in it."""

    def written():
        return (folder / STATE_FILE).stat().st_mtime_ns

    # The first to come may have been begun before.
    for _ in range(2):
        before, given_up = written(), time.monotonic() + ENDED_S
        while written() == before and time.monotonic() < given_up:
            time.sleep(0.005)
    return read_state(folder)
