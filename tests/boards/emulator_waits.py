"""Helpers that wait for an emulator on a busy machine, and that fork processes with a fake board,
for tests that stop a process."""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import dataclass, field

from smarttouch.base.errors import LineLostError
from smarttouch.boards.shutdown import enter, leave
from smarttouch.emulator.firmware_base import STATE_FILE, read_state

from ..support.processes import Forked
from ..support.runs import HANGS_S, until

__all__ = ["HANGS_S", "until"]

ENDED_S = 1.0
"""An emulator counts as ended if it writes no new state file for this time."""


def deliver(board, *sequences, times=1):
    """Send sequences one after another, each when the board has delivered the one before."""
    for sequence in sequences:
        board.send(sequence, times)
        board.drain()


@contextlib.contextmanager
def starter():
    """Yield a function that starts processes, by default as `Forked`; kill them all at the end."""
    started = []

    def start(command, kind=Forked, **options):
        process = kind(command, **{"stdout": subprocess.PIPE, "text": True} | options)
        started.append(process)
        return process

    try:
        yield start
    finally:
        for process in started:
            process.kill()
            process.communicate()


def fresh_state(folder):
    """Return the counters that an emulator writes. They include all slots before this call."""

    def written():
        return (folder / STATE_FILE).stat().st_mtime_ns

    # The emulator may have collected the first state before this call: wait for a second one.
    for _ in range(2):
        before, given_up = written(), time.monotonic() + ENDED_S
        while written() == before and time.monotonic() < given_up:
            time.sleep(0.005)
    return read_state(folder)


PATIENCE_S = 20
ANSWERED_S = 0.2
"""Time for the thread of the run registry to write its answer before the process ends."""


@dataclass(eq=False)
class Display:
    """Fake board, which records each call that sets it to zero."""

    budget_ua: int = 10_000
    announced: bool = True
    confirms: bool = True
    error: type[Exception] = LineLostError
    zeros: list[str] = field(default_factory=list)

    def halt(self):
        self.zero("halt")

    def stop(self):
        self.zero("stop")

    def zero(self, how):
        self.zeros.append(how)
        if not self.confirms:
            raise self.error("the line is lost")

    def __enter__(self):
        enter(self)
        return self

    def __exit__(self, *_):
        leave(self, at_zero=self.confirms)


@contextlib.contextmanager
def in_child(work):
    """Run ``work(say)`` in a forked process; yield its process id once `work` has called ``say``.

    The exit code is that of `work`. At the end of the block the process is killed.
    """
    ready, begun = os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        try:
            code = work(lambda: os.write(begun, b".")) or 0
        except SystemExit as ended:
            code = ended.code
        except KeyboardInterrupt:
            code = 130
        finally:
            os._exit(code)
    os.close(begun)
    try:
        assert os.read(ready, 1) == b"."
        yield child
    finally:
        os.close(ready)
        for act in (lambda: os.kill(child, signal.SIGKILL), lambda: os.waitpid(child, 0)):
            with contextlib.suppress(ProcessLookupError, ChildProcessError):
                act()


def until_zero(board, seconds=PATIENCE_S):
    """Return a function that opens a board and waits for zero. It returns 7, or 98 on timeout."""

    def work(say):
        with board:
            say()
            end_s = time.monotonic() + seconds
            while not board.zeros and time.monotonic() < end_s:
                time.sleep(0.002)
            time.sleep(ANSWERED_S)
        return 7 if board.zeros else 98

    return work


def exit_code(child):
    """Wait until a child process has ended; return its exit code."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
