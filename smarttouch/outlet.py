"""Text to a terminal that may have stopped reading: whoever writes it never waits."""

import io
import os
import select
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from smarttouch.errors import SmartTouchError
from smarttouch.terminal import Output

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

MOST_WAITING = 1 << 18
"""Bytes that wait for a terminal; what comes beyond is dropped."""
LAST_WORDS_S = 0.2
"""Longest time that the end of a stopped run waits for a terminal."""
_STEP_S = 0.05


class Outlet:
    """Writes to file descriptors from a thread of its own, in order."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._size = 0
        self._writing = False
        self._failure: OSError | None = None
        self._changed = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._write_all, name="terminal", daemon=True)
        self._thread.start()

    def put(self, number: int, data: bytes) -> None:
        """Queue bytes; raise the error of earlier ones, if any."""
        with self._changed:
            if self._failure is not None:
                failure, self._failure = self._failure, None
                raise failure
            if self._size <= MOST_WAITING:
                self._waiting.append((number, data))
                self._size += len(data)
                self._changed.notify_all()

    def drain(self, seconds: float) -> bool:
        """Return whether all is written within a time; raise the error of a write, if any."""
        with self._changed:
            done = self._changed.wait_for(lambda: not self._waiting and not self._writing, seconds)
            failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        return done

    def close(self) -> None:
        """Stop writing."""
        with self._changed:
            self._over = True
            self._waiting.clear()
            self._changed.notify_all()

    def _write_all(self) -> None:
        while True:
            with self._changed:
                self._writing = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._waiting or self._over)
                if self._over:
                    return
                number, data = self._waiting.popleft()
                self._size -= len(data)
                self._writing = True
            try:
                while data:
                    data = data[os.write(number, data) :]
            except BlockingIOError:
                with self._changed:
                    self._waiting.appendleft((number, data))
                    self._size += len(data)
                select.select([], [number], [], 0.1)
            except OSError as error:
                self._failure = error


class _Stream(io.RawIOBase):
    """A file descriptor that takes everything at once."""

    def __init__(self, outlet: Outlet, number: int) -> None:
        self._outlet, self._number = outlet, number

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._number

    def isatty(self) -> bool:
        return os.isatty(self._number)

    def write(self, data: "ReadableBuffer") -> int:
        taken = bytes(data)
        self._outlet.put(self._number, taken)
        return len(taken)


@contextmanager
def never_waiting(stopped: Callable[[], bool]) -> Iterator[None]:
    """Queue all that is printed in the block, so that only its end waits.

    Once ``stopped`` returns true, output that a terminal does not take soon is dropped.
    """
    outlet = Outlet()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_through(stream, outlet) for stream in before)
    try:
        yield
    finally:
        ours = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = before
        try:
            for stream in ours:
                stream.flush()
            while not outlet.drain(_STEP_S) and not stopped():
                pass
            outlet.drain(LAST_WORDS_S)
        except BrokenPipeError:
            raise
        except OSError as error:
            message = f"cannot write to standard output: {error.strerror}"
            raise SmartTouchError(message, about="standard output") from None
        finally:
            outlet.close()


def _through(stream: TextIO, outlet: Outlet) -> TextIO:
    """Return a stream to the same place that never waits, or the same stream if it is no file."""
    try:
        number = stream.fileno()
        stream.flush()
    except (OSError, ValueError, AttributeError):
        return stream
    ours = io.TextIOWrapper(
        io.BufferedWriter(_Stream(outlet, number)),
        stream.encoding,
        stream.errors,
        line_buffering=getattr(stream, "line_buffering", False),
    )
    # What a terminal would obey is kept from it here too.
    return stream.onto(ours) if isinstance(stream, Output) else ours
