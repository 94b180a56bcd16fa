"""Progress bars."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from rich.progress import Progress

from smarttouch.base import terminal

Advance = Callable[[int, int], None]  # function called with how many are done, of how many


def bank_progress(quiet: bool) -> AbstractContextManager[Advance | None]:
    """Yield a function that shows how many sites of a kernel bank are designed; None if quiet."""
    return _bar("Designing kernels", quiet)


@contextmanager
def lines_progress(quiet: bool, title: str = "Reading lines") -> Iterator[Advance]:
    """Yield a function that shows how many lines have been read, or how much else is done."""
    with _bar(title, quiet) as advance:
        yield advance or (lambda _done, _total: None)


@contextmanager
def _bar(title: str, quiet: bool) -> Iterator[Advance | None]:
    if quiet:
        yield None
        return
    bar = Progress(console=terminal.console(stderr=True), transient=True)
    task = bar.add_task(title)

    def advance(done: int, total: int) -> None:
        # Most runs find a finished bank, and show nothing.
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()


def first_line_awaited(wait: Callable[[], object], quiet: bool) -> None:
    """Show that a text is being prepared until its first line is ready."""
    if quiet:
        wait()
        return
    with terminal.console(stderr=True).status("Preparing the text"):
        wait()
