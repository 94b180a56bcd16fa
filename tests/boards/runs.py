"""Runs of other processes, for tests that stop them: forks with a board that notes its zero."""

import contextlib
import os
import signal
import time
from dataclasses import dataclass, field

from smarttouch.base.errors import LineLostError
from smarttouch.boards.shutdown import enter, leave

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
