"""A session: a board that is open, on which a program shows patterns."""

import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Self

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import StopRequest
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.listener import Listener
from smarttouch.running.loop import Loop
from smarttouch.running.program import CANCELED, Pattern, Program, Shown
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.runner import Runner
from smarttouch.running.step import StepResult
from smarttouch.sources.force import ForceSource


class Session(Program):
    """An open board on which a program shows patterns: made by `Display.session`.

    The board is open in its ``with`` block. What ends the block, whatever it is, puts all
    electrodes at zero. Its methods may be called from any thread.

    Attributes
    ----------
    statistics : RunStatistics
        Of all that was sent; complete after the block.

    Examples
    --------
    >>> import smarttouch as st
    >>> import numpy as np
    >>> ring = np.zeros(64, np.float32)
    >>> ring[[18, 19, 20, 26, 28, 34, 35, 36]] = 1
    >>> with st.open_display("simulated:").session(mode="RA", intensity=0.6) as touch:
    ...     seconds = touch.rise()
    ...     shown = touch.show(ring, 0.5)
    >>> shown.sequences, shown.intensity, shown.ramped_s
    (25, 0.6, 0.0)
    """

    ended = "the session is over"

    def __init__(
        self,
        display: Display,
        config: RunConfig,
        listeners: Iterable[Listener | Callable[[StepResult], object]] = (),
        force: ForceSource | str | None = None,
    ) -> None:
        super().__init__(display.profile)
        self._display, self._stop = display, StopRequest()
        runner = Runner(self, display, config, force=force, listeners=listeners, stop=self._stop)
        self.statistics: RunStatistics = runner.statistics
        self._run: AbstractContextManager[Loop] = runner.running()

    def __repr__(self) -> str:
        return f"Session({self._display!r}, {'closed' if self._loop is None else 'open'})"

    def __enter__(self) -> Self:
        if self.statistics.ended:
            raise SmartTouchError("a session is entered once: ask its display for another")
        self._loop = self._run.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        kind, error, _ = exception
        if isinstance(kind, type) and error is not self._failed:
            # Whatever went wrong, the skin gets nothing more.
            self._stop.ask(f"the program ended in {kind.__name__}")
        loop, self._outside = self._loop, "its with block is over"
        self._leave()
        try:
            if self._failed is not None:
                raise self._failed
            if loop is not None:
                loop.end()
        except BaseException as failed:
            self._run.__exit__(type(failed), failed, failed.__traceback__)
            if kind is None:
                raise
        else:
            self._run.__exit__(None, None, None)

    def stop(self) -> None:
        """End the session: all electrodes are at zero when this returns."""
        self._stop.ask("the session was stopped")


def show_together(
    patterns: Mapping[Session, Pattern], seconds: float, level: float = 1.0
) -> dict[Session, Shown]:
    """Show patterns on several displays at the same time; return how each was shown.

    Levels that are not open are opened first, at the same time.

    Parameters
    ----------
    patterns : mapping of Session to pattern
        See `Session.show`.
    seconds : float, s
    level : float, in [0, 1]

    Examples
    --------
    >>> import smarttouch as st
    >>> import numpy as np
    >>> dot = np.eye(64, dtype=np.float32)[27]
    >>> displays = st.open_display("memory:"), st.open_display("memory:")
    >>> one, other = (each.session(mode="RA", intensity=0.5) for each in displays)
    >>> with one, other:
    ...     shown = st.show_together({one: dot, other: dot}, 0.2)
    >>> [each.sequences for each in shown.values()]
    [10, 10]
    """
    canceled = threading.Event()
    with ThreadPoolExecutor(max(1, len(patterns)), "show", CANCELED.set, (canceled,)) as pool:
        try:
            for rising in [pool.submit(each.rise, level, patterns[each]) for each in patterns]:
                rising.result()
            showing = [pool.submit(each.show, patterns[each], seconds, level) for each in patterns]
            return {each: shown.result() for each, shown in zip(patterns, showing, strict=True)}
        except BaseException:
            canceled.set()
            raise
