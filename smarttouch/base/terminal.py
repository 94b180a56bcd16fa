"""Output to a terminal: no control characters, no waiting for one that has stopped reading."""

import contextlib
import io
import os
import re
import select
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Self, TextIO

from smarttouch.base.errors import SmartTouchError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer
    from rich.console import Console

_OBEYED = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
"""Controls, signs that turn the order of what follows or cannot be seen, and halves of signs."""


def printable(text: str) -> str:
    """Return a text with a visible stand-in for each control character.

    Newlines and tabs stay. A control sign becomes its picture (␛ is Escape), any other becomes �.
    """
    return _OBEYED.sub(_stand_in, text)


def _stand_in(found: re.Match[str]) -> str:
    code = ord(found[0])
    if code < 0x20:
        return chr(0x2400 + code)
    return "␡" if code == 0x7F else "�"


class GuardedStream:
    """Standard stream whose failures become one sentence; without a name they are dropped."""

    def __init__(self, stream: TextIO, name: str) -> None:
        self._stream, self._name = stream, name

        self.encoding: str = stream.encoding
        self.errors: str | None = stream.errors

    def onto(self, stream: TextIO) -> Self:
        """Return a stream that writes to another one in the same way."""
        return type(self)(stream, self._name)

    @property
    def closed(self) -> bool:
        return self._stream.closed

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def write(self, text: str) -> int:
        self._guarded(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._guarded(self._stream.flush)

    def _guarded(self, act: Callable[..., object], *arguments: str) -> None:
        try:
            act(*arguments)
        except BrokenPipeError:
            if self._name:
                raise
        except OSError as error:
            if self._name:
                raise SmartTouchError(f"cannot write to {self._name}: {error.strerror}") from None


class PlainStream(GuardedStream):
    """Standard stream for plain text.

    It does not report to be a terminal: code that draws uses `console`.
    """

    def __init__(self, stream: TextIO, name: str) -> None:
        super().__init__(stream, name)
        self.direct: GuardedStream = GuardedStream(stream, name)

    def isatty(self) -> bool:
        return False

    def write(self, text: str) -> int:
        super().write(printable(text))
        return len(text)


def console(*, stderr: bool = False, highlight: bool = True) -> "Console":
    """Return a console for drawing, with stand-ins for control characters."""
    stream: Any = sys.stderr if stderr else sys.stdout
    return _console_class()(
        file=getattr(stream, "direct", stream), highlight=highlight, markup=False, emoji=False
    )


def draws(shown: "Console | None" = None) -> bool:
    """Return whether a console, standard output by default, is a screen that can be drawn on."""
    shown = shown or console()
    return shown.is_terminal and not shown.is_dumb_terminal


_WIDEST = 200
_LONGEST_NAME = 40  # longest text at the left of a table that stays in one line


def print_table(
    rows: Iterable[Sequence[Any]],
    heading: Sequence[str] = (),
    *,
    title: str | None = None,
    note: str | None = None,
    ruled: bool = False,
    left: int = 1,
) -> None:
    """Print a table of texts; its first ``left`` columns are aligned left, the others right.

    In a pipe or a dumb terminal there are no rules, which would be read aloud, and a row of several
    texts is a line.
    """
    from rich.box import HEAVY_HEAD
    from rich.table import Table

    rows, shown = list(rows), console()
    drawn = ruled and draws(shown)
    if left > 1 and not draws(shown):
        shown.width = _WIDEST
    names = all(len(str(row[0])) <= _LONGEST_NAME for row in rows if row)
    table = Table(
        title=title,
        title_justify="left",
        box=HEAVY_HEAD if drawn else None,
        pad_edge=drawn,
        show_header=bool(heading),
    )
    for column in range(len(heading or max(rows, key=len, default=()))):
        table.add_column(
            heading[column] if heading else "",
            justify="left" if column < left else "right",
            # Sentences at the left must leave room for what stands beside them.
            no_wrap=ruled or (column == 0 and names),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    shown.print(table)
    if note is not None:
        shown.print(note, style="dim", soft_wrap=True)


@cache
def _console_class() -> "type[Console]":
    # Not above: it takes a tenth of a second, and help needs none.
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class SafeConsole(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            for segment in super().render(renderable, options):
                safe = segment.text if segment.control else printable(segment.text)
                yield segment if safe == segment.text else segment._replace(text=safe)

    return SafeConsole


@contextlib.contextmanager
def guarded_output() -> Iterator[None]:
    """Guard standard output and errors against control characters, while the block runs.

    Standard streams that were closed lead nowhere from then on: a file or port
    that is opened later must not become one of them.
    """
    _fill_closed()
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    output: Any = PlainStream(before[0], "standard output")
    errors: Any = PlainStream(before[1], "")
    sys.stdout, sys.stderr = output, errors
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _fill_closed() -> None:
    """Open the null device in place of each standard stream that is closed."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # The lowest number that is free, so this one.
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
            setattr(sys, name, os.fdopen(nothing, "w" if number else "r", encoding="utf-8"))


MOST_WAITING = 1 << 18  # bytes that wait for a terminal; what comes beyond is dropped
LAST_WORDS_S = 0.2  # longest time that the end of a stopped run waits for a terminal
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
            raise SmartTouchError(message) from None
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
    return stream.onto(ours) if isinstance(stream, GuardedStream) else ours
