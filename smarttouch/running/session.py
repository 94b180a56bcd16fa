"""A session: a board that is open, and a loop that shows patterns when a program asks for them."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from types import TracebackType
from typing import Self

from smarttouch.base.stopping import StopRequest
from smarttouch.boards.shutdown import stoppable_run
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.listener import Listener
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.runner import Runner
from smarttouch.running.session_feed import Pattern, SessionFeed
from smarttouch.running.show_request import Show
from smarttouch.running.step import StepResult
from smarttouch.running.touch import Shown, Touch
from smarttouch.sources.force import ForceSource

_TOGETHER_NS = 60_000_000  # from the call to the start of patterns that begin together
_END_S = 5.0  # time for a session that is over to report why


class Session(Touch):
    """An open board on which a program shows patterns: made by `Display.session`.

    In its ``with`` block the board is open and a loop of its own keeps the board's period. What
    ends the block, whatever it is, puts all electrodes at zero. Its methods may be called from any
    thread.

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

    def __init__(
        self,
        display: Display,
        config: RunConfig,
        listeners: Iterable[Listener | Callable[[StepResult], object]] = (),
        force: ForceSource | str | None = None,
    ) -> None:
        self._display, self._stop = display, StopRequest()
        super().__init__(SessionFeed(display.profile, stop=self._stop))
        self._runner = Runner(
            self._feed, display, config, force=force, listeners=listeners, stop=self._stop
        )
        self.statistics: RunStatistics = self._runner.statistics
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._block = contextlib.ExitStack()

    def __repr__(self) -> str:
        state = "open" if self._thread.is_alive() else "closed"
        return f"Session({self._display!r}, {state})"

    def __enter__(self) -> Self:
        # In the thread of the block: only the main one can handle signals.
        self._block.enter_context(stoppable_run(StopRequest(), self._display.board))
        try:
            self._thread.start()
            self._feed.began.wait()
            self._require_life()
        except BaseException as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _at: TracebackType | None,
    ) -> None:
        with self._block:
            if kind is not None:
                # Whatever went wrong, the skin gets nothing more.
                self._stop.ask(f"the program ended in {kind.__name__}")
            self._feed.end()
            self._thread.join()
        if self._failed is not None and kind is None:
            raise self._failed

    def _run(self) -> None:
        try:
            self._runner.run()
        except BaseException as error:
            self._failed = error
        finally:
            self._feed.close()

    def stop(self) -> None:
        """End the session: all electrodes are at zero when this returns."""
        self._stop.ask("the session was stopped")
        self._feed.end()

    def _require_life(self) -> None:
        loop = self._thread
        if self._feed.is_over and loop.is_alive() and loop is not threading.current_thread():
            loop.join(_END_S)
        if self._failed is not None:
            raise self._failed
        if not loop.is_alive():
            self._feed.end()
        super()._require_life()

    def _ended(self) -> str:
        return self.statistics.ended or "it is not in its with block"


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
    _carry_out({each: each._rising(level, where) for each, where in patterns.items()})
    at_ns = time.monotonic_ns() + _TOGETHER_NS
    return _carry_out(
        {each: each._showing(what, seconds, level, at_ns=at_ns) for each, what in patterns.items()}
    )


def _carry_out(shows: Mapping[Session, Show]) -> dict[Session, Shown]:
    """Carry out requests to several sessions at the same time."""
    with contextlib.ExitStack() as stack:
        # In one order for all threads that do so.
        for each in sorted(shows, key=id):
            stack.enter_context(each.begun(shows[each]))
        for show in shows.values():
            show.over.wait()
    return {session: session.result(show) for session, show in shows.items()}
