"""Keys, output and signals of a command in a terminal."""

import contextlib
import functools
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, ParamSpec, TypeVar

from smarttouch.base.posix import termios, tty
from smarttouch.base.stopping import RunStopped, StopRequest
from smarttouch.boards.shutdown import current_command, running_command

LOST = ""  # key that reports a closed terminal
JOIN_S = 0.3  # at the end, longest wait for a key that is being handled
_TURN_S = 0.05  # longest wait for keys or for the terminal between two drawings
_before: list[list[Any]] = []  # the terminal's original settings; empty if unchanged


def restore() -> None:
    """Restore the terminal's settings at once, without waiting for pending output."""
    if _before:
        # The terminal may be closed.
        with suppress(termios.error):
            termios.tcsetattr(sys.stdin, termios.TCSANOW, _before.pop())


class Output:
    """Standard stream that buffers output which the terminal does not accept yet.

    A `Terminal` sends the buffer in non-blocking writes. If the stream is not a file, or if the
    system has no non-blocking writes, output is not buffered.
    """

    def __init__(self, stream: Any) -> None:
        self.number: int | None = None
        """File descriptor for non-blocking writes. It is None unless output is buffered."""
        self.waiting = bytearray()
        self.failure: OSError | None = None
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def open(self) -> None:
        """Buffer output from now on."""
        if termios is None:
            return
        with suppress(OSError, ValueError, AttributeError):
            self._stream.flush()
            number = self._stream.fileno()
            try:
                # Open the terminal again, so that only this new descriptor is non-blocking.
                flags = os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK
                self.number = os.open(os.ttyname(number), flags)
            except OSError:
                self.number = os.dup(number)

    def write(self, text: str) -> int:
        if self.number is not None:
            self.waiting += text.encode(self._stream.encoding or "utf-8", "backslashreplace")
        else:
            # First write the rest of the buffer, as bytes: the rest may begin within a character.
            while self.waiting:
                del self.waiting[: os.write(self._stream.fileno(), self.waiting)]
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        if self.number is None:
            self._stream.flush()

    def send(self) -> None:
        """Send as many bytes of the buffer as the terminal accepts without blocking."""
        assert self.number is not None
        try:
            # A pipe accepts up to PIPE_BUF bytes either all at once or not at all.
            del self.waiting[: os.write(self.number, self.waiting[: select.PIPE_BUF])]
        except BlockingIOError:
            time.sleep(_TURN_S)
        except OSError as error:
            self.failure = self.failure or error
            self.waiting.clear()

    def close(self) -> None:
        """End buffering. The next `write` first sends the rest of the buffer."""
        number, self.number = self.number, None
        if number is not None:
            os.close(number)


class Terminal:
    """Thread that reads keys, draws and sends output, without waiting for the terminal.

    ``on_key`` receives each key. Arrow keys are ``up``, ``down``, ``left`` and ``right``; `LOST`
    reports that the terminal was closed. ``draw`` is called repeatedly.
    """

    def __init__(
        self,
        on_key: Callable[[str], None] | None = None,
        outputs: Sequence[Output] = (),
        draw: Callable[[], None] = lambda: None,
    ) -> None:
        self._on_key, self._outputs, self._draw = on_key, outputs, draw
        self._over, self._left = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._work, name="terminal", daemon=True)

    def open(self) -> None:
        """Start to draw and, if there is a keyboard, to read keys."""
        if termios is None or not sys.stdin.isatty():
            self._on_key = None
        for output in self._outputs:
            output.open()
        if self._on_key is not None:
            _before.append(termios.tcgetattr(sys.stdin))
            # With TCSANOW, do not wait for pending output: the terminal may never accept it.
            tty.setcbreak(sys.stdin, termios.TCSANOW)
        if self._on_key is not None or self._outputs:
            self._thread.start()

    def close(self, patience_s: float = 0.0) -> None:
        """Send the remaining output for at most ``patience_s``, then restore the terminal."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(patience_s)
            self._left.set()
            self._thread.join(JOIN_S)
        if self._on_key is not None:
            restore()
        for output in self._outputs:
            output.close()

    def _work(self) -> None:
        on_key = self._on_key
        try:
            while not self._left.is_set():
                over = self._over.is_set()
                self._draw()
                waiting = [output for output in self._outputs if output.waiting]
                if over and not waiting:
                    return
                keys = [] if on_key is None or over else [sys.stdin.fileno()]
                numbers = [output.number for output in waiting if output.number is not None]
                if not keys and not numbers:
                    self._over.wait(_TURN_S)
                    continue
                heard, taken, _ = select.select(keys, numbers, [], _TURN_S)
                for output in waiting:
                    if output.number in taken:
                        output.send()
                if heard and on_key is not None and not _pass_keys(keys[0], on_key):
                    on_key = None
        except BaseException:
            # Without this thread no key works, so end the run as if the terminal were closed.
            (on_key or (lambda _key: None))(LOST)
            raise


@contextmanager
def keyboard_listener(on_key: Callable[[str], None]) -> Iterator[None]:
    """Call a function with each key, from a thread, while the block runs; see `Terminal`."""
    terminal = Terminal(on_key)
    with contextlib.closing(terminal):
        terminal.open()
        yield


def _pass_keys(number: int, on_key: Callable[[str], None]) -> bool:
    """Call ``on_key`` with the pressed keys; return False if the terminal is closed."""
    try:
        data = os.read(number, 64)
    except OSError:
        data = b""
    for key in _keys(data.decode("utf-8", "replace")):
        on_key(key)
    if not data:
        on_key(LOST)
    return bool(data)


def _keys(text: str) -> Iterator[str]:
    names = {"A": "up", "B": "down", "C": "right", "D": "left"}
    arrows = {f"\x1b{mode}{end}": name for mode in "[O" for end, name in names.items()}
    while text:
        arrow = arrows.get(text[:3])
        yield arrow or text[0]
        text = text[3:] if arrow else text[1:]


_P = ParamSpec("_P")
_T = TypeVar("_T")
_CURSOR_ON = b"\x1b[?25h"


def drives_a_board(command: Callable[_P, _T]) -> Callable[_P, _T]:
    """Decorate a command, so that signals and ``smarttouch stop`` can end the command."""

    @functools.wraps(command)
    def stoppable(*arguments: _P.args, **options: _P.kwargs) -> _T:
        try:
            with running_command(_give_up):
                return command(*arguments, **options)
        except RunStopped as stopped:
            print(f"smarttouch: ended by {stopped}; no board is open", file=sys.stderr)
            raise

    return stoppable


def command_stop() -> StopRequest:
    """Return the stop request of the running command."""
    return current_command().stop


def by_signal() -> bool:
    """Return whether a signal is ending the running command."""
    return bool(current_command().number)


@contextmanager
def ending_in_order(patience_s: float | None = None) -> Iterator[None]:
    """Run the block so that signals do not interrupt it. After a signal, the block must end by
    itself within ``patience_s``. Outside such a block, a signal raises RunStopped."""
    command = current_command()
    command.patience_s = patience_s or command.patience_s
    before, command.orderly = command.orderly, True
    try:
        yield
    finally:
        command.orderly = before


def _give_up(number: int) -> None:
    """End the process at once, because something blocks the end of the command."""
    restore()
    with suppress(OSError, ValueError):
        for descriptor in (1, 2):
            if os.isatty(descriptor):
                os.set_blocking(descriptor, False)
                try:
                    os.write(descriptor, _CURSOR_ON)
                finally:
                    os.set_blocking(descriptor, True)
    os._exit(128 + number)
