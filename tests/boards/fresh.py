"""Waiting for what an emulator's process does, for as long as a busy machine takes; and runs
of other processes, for tests that stop them: forks with a board that notes its zero."""

import contextlib
import os
import signal
import subprocess
import time
from dataclasses import dataclass, field

from smarttouch.base.errors import LineLostError
from smarttouch.boards.shutdown import enter, leave
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

    try:
        yield start
    finally:
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


PATIENCE_S = 20
ANSWERED_S = 0.2
"""Time that a thread of a run has to write its answer before the process ends."""


@dataclass(eq=False)
class Display:
    """What the shutdown of a process knows of a board."""

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
    """Do something in a forked process, to whose end the block may come; yield its number.

    It exits with what `work` returns, or the code of its SystemExit.
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
    """Return work that opens a board and waits until it was put at zero: exit code 7."""

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
    """Return the exit code of a child, once it has ended."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
