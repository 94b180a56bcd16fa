"""A bar for work that takes a while."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress


@contextmanager
def bank_progress(quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Yield what shows how many sites of a kernel bank are designed; None if quiet."""
    if quiet:
        yield None
        return
    bar = Progress(console=Console(stderr=True), transient=True)
    task = bar.add_task("Designing kernels")

    def advance(done: int, total: int) -> None:
        # Most runs find a bank ready: nothing is shown unless there is work.
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()
