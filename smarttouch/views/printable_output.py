"""Output to a terminal, with control characters replaced."""

import contextlib
import io
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, TextIO

from smarttouch.base.errors import SmartTouchError

if TYPE_CHECKING:
    from rich.console import Console

_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
"""Control characters, bidirectional and invisible characters, and lone surrogates."""


def printable(text: str) -> str:
    """Return a text with control characters replaced by visible ones.

    Newlines and tabs stay. C0 control characters become symbols, such as ␛; others become �.
    """
    return _CONTROL.sub(_visible, text)


def _visible(match: re.Match[str]) -> str:
    code = ord(match[0])
    if code < 0x20:
        return chr(0x2400 + code)
    return "␡" if code == 0x7F else "�"


def write_failure(error: OSError, name: str) -> Exception:
    """Return the error to raise after a failed write; a BrokenPipeError stays unchanged."""
    if isinstance(error, BrokenPipeError):
        return error
    return SmartTouchError(f"cannot write to {name}: {error.strerror}")


class PlainStream:
    """Standard stream. A failed write raises the error of `write_failure`.

    If ``name`` is empty, failures are ignored. With ``plain``, control characters are replaced, and
    `isatty` returns False, so that no library draws. Only `console` draws; it writes to `direct`.
    """

    def __init__(self, stream: TextIO, name: str, plain: bool = True) -> None:
        self._stream, self._name, self._plain = stream, name, plain

    def __getattr__(self, name: str) -> Any:
        # Do not expose `buffer` and `writelines`, which would bypass the replacement.
        if name not in ("encoding", "errors", "closed", "fileno", "writable"):
            raise AttributeError(name)
        return getattr(self._stream, name)

    @property
    def direct(self) -> "PlainStream":
        """This stream without replacement of control characters, for drawing."""
        return PlainStream(self._stream, self._name, plain=False)

    def isatty(self) -> bool:
        return not self._plain and self._stream.isatty()

    def write(self, text: str) -> int:
        self._guarded(self._stream.write, printable(text) if self._plain else text)
        return len(text)

    def flush(self) -> None:
        self._guarded(self._stream.flush)

    def _guarded(self, act: Callable[..., object], *arguments: str) -> None:
        try:
            act(*arguments)
        except OSError as error:
            if self._name:
                raise write_failure(error, self._name) from None


def console(*, stderr: bool = False, highlight: bool = True) -> "Console":
    """Return a console of rich that replaces control characters."""
    stream: Any = sys.stderr if stderr else sys.stdout
    return _console_class()(
        file=getattr(stream, "direct", stream), highlight=highlight, markup=False, emoji=False
    )


def draws(shown: "Console | None" = None) -> bool:
    """Return whether a console (default: standard output) is a terminal that can be drawn on."""
    shown = shown or console()
    return shown.is_terminal and not shown.is_dumb_terminal


_WIDEST = 200
_LONGEST_NAME = 40  # if a text of the first column has more characters, the column is wrapped


def print_table(
    rows: Sequence[Sequence[Any]], heading: Sequence[str] = (), *, left: int = 1
) -> None:
    """Print a table of texts; its first ``left`` columns are aligned left, the others right."""
    from rich.table import Table

    shown = console()
    if left > 1 and not draws(shown):
        shown.width = _WIDEST  # never wrap rows
    table = Table(box=None, pad_edge=False, show_header=bool(heading))
    # If the first column has sentences, wrap them, so that the other columns fit.
    names = all(len(str(row[0])) <= _LONGEST_NAME for row in rows)
    for column, name in enumerate(heading or [""] * max(map(len, rows), default=0)):
        justify: Any = "left" if column < left else "right"
        table.add_column(name, justify=justify, no_wrap=not column and names, overflow="fold")
    for row in rows:
        table.add_row(*row)
    shown.print(table)


@cache
def _console_class() -> "type[Console]":
    # Import rich late: the import takes 0.1 s, and --help does not need rich.
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
    """Replace control characters in standard output and errors while the block runs.

    Closed standard streams are opened on the null device. Otherwise a file or port that is opened
    later would get the descriptor of a standard stream.
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
            # The system assigns the lowest free descriptor, which is ``number``.
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            nothing = os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, os.fdopen(nothing, "w" if number else "r", encoding="utf-8"))
