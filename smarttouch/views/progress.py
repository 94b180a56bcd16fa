"""Progress bars, or a line every ten seconds if the output is not a terminal."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from smarttouch.views import printable_output

_LINE_S = 10.0
Advance = Callable[[int, int], None]  # called with the number of completed items and their total


def bank_progress() -> AbstractContextManager[Advance]:
    """Show the progress of a kernel design; yield the function that reports progress."""
    return progress("Designing kernels")


@contextmanager
def progress(title: str = "Reading lines") -> Iterator[Advance]:
    """Show progress; yield the function that reports it."""
    bar: Any = None  # a Progress of rich
    begun_s = printed_s = time.monotonic()

    def advance(done: int, total: int) -> None:
        from rich.progress import Progress

        nonlocal bar, printed_s
        now_s = time.monotonic()
        if bar is None:
            bar = Progress(console=printable_output.console(stderr=True), transient=True)
            bar.add_task(title)
        if printable_output.draws(bar.console):
            # Show the bar only when the first progress is reported.
            bar.start()
            bar.update(bar.task_ids[0], completed=done, total=total)
        elif done and now_s > printed_s + _LINE_S:
            printed_s = now_s
            left_s = (now_s - begun_s) * (total - done) / done
            bar.console.print(f"{title}: {done / total:.0%}, about {left_s:.0f} s left")

    try:
        yield advance
    finally:
        if bar is not None and bar.live.is_started:
            bar.stop()


def first_line_awaited(wait: Callable[[], object]) -> None:
    """Show a message until the first line of a text is ready."""
    with printable_output.console(stderr=True).status("Preparing the text"):
        wait()
