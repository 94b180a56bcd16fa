"""A session: a board that is open, and a loop that shows patterns when a program asks for them."""

import asyncio
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import LevelNotReachedError, SmartTouchError
from smarttouch.base.events import Note
from smarttouch.base.stopping import StopRequest
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.listener import Listener
from smarttouch.running.runner import Runner
from smarttouch.running.session_feed import Pattern, SessionFeed, Show
from smarttouch.running.step import RunStatistics, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame

_PATIENCE_S = 10.0
_TOGETHER_NS = 60_000_000  # from the call to the start of patterns that begin together


@dataclass(frozen=True)
class Shown:
    """How a pattern was shown.

    Attributes
    ----------
    time_ns : int
        When its first sequence was sent, since the start of the session.
    clock_ns : int
        When its first pulse began, by the machine's clock, `time.monotonic_ns`; when it was sent,
        if the board does not say when it began.
    board_us : int or None, µs
        When its first pulse began, by the board's own clock; None if the board does not say.
    sequences, pulses : int
        Sequences sent, and the slots of all of them.
    intensity : float, in [0, 1]
        The lowest of its sequences.
    ramped_s : float, s
        How long its level took to open before it; 0 where it was open.
    """

    time_ns: int
    clock_ns: int
    board_us: int | None
    sequences: int
    pulses: int
    intensity: float
    ramped_s: float


class Session:
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
        self._feed = SessionFeed(display.profile, display.board.simulated_time, self._stop)
        self._runner = Runner(
            self._feed, display, config, force=force, listeners=[self._feed.watch, *listeners],
            stop=self._stop,
        )  # fmt: skip
        self.statistics: RunStatistics = self._runner.statistics
        self._failed: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="session", daemon=True)
        self._one_at_a_time = threading.Lock()

    def __repr__(self) -> str:
        state = "open" if self._thread.is_alive() else "closed"
        return f"Session({self._display!r}, {state})"

    def __enter__(self) -> Self:
        self._thread.start()
        self._feed.began.wait()
        if self._failed is not None:
            self._thread.join()
            raise self._failed
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _at: TracebackType | None,
    ) -> None:
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
            self._feed.close_for_good()

    # -- what is shown ------------------------------------------------------

    def rise(self, level: float = 1.0, pattern: Pattern | None = None) -> float:
        """Open a level by its ramp, with pulses of threshold; return how long it took, s.

        Parameters
        ----------
        level : float, in [0, 1]
            Part of the session's intensity.
        pattern : ndarray or Frame, optional
            Where these pulses are, see `show`; in the middle of the array if not given.

        Raises
        ------
        LevelNotReachedError
            If it cannot be opened, as where no finger presses.
        """
        show = Show(self._checked(pattern), level, 0.0, patience_s=_PATIENCE_S)
        return self._show(show).ramped_s

    def show(
        self, pattern: Pattern, seconds: float, level: float = 1.0, *, at_ns: int | None = None
    ) -> Shown:
        """Show a pattern for some time, and return when it is over.

        Where its level is not open, pulses of threshold open it first.

        Parameters
        ----------
        pattern : ndarray or Frame
            Activation of the mode's class, (E,), or of each class, (3, E), in [0, 1]; or an image,
            (H, W) uint8.
        seconds : float, s
        level : float, in [0, 1]
            Part of the session's intensity.
        at_ns : int, optional
            When it is to begin, by `time.monotonic_ns`; as soon as may be if not given.

        Raises
        ------
        LevelNotReachedError
            If the level cannot be opened, or was lost meanwhile.
        SmartTouchError
            If the pattern is none, or the session has ended.
        """
        if not seconds > 0:
            raise SmartTouchError(f"seconds {seconds:g} must be above 0", about="seconds")
        return self._show(Show(self._checked(pattern), level, seconds, _PATIENCE_S, at_ns))

    async def show_async(self, pattern: Pattern, seconds: float, level: float = 1.0) -> Shown:
        """Show a pattern as `show` does, while other tasks go on."""
        return await asyncio.to_thread(self.show, pattern, seconds, level)

    async def rise_async(self, level: float = 1.0, pattern: Pattern | None = None) -> float:
        """Open a level as `rise` does, while other tasks go on."""
        return await asyncio.to_thread(self.rise, level, pattern)

    def put(self, pattern: Pattern, stale_s: float = 0.5) -> None:
        """Show a pattern from now on, until the next one or until it is stale; return at once.

        The newest wins, and begins as soon as what is under way has ended. A stale one makes no
        current.

        Parameters
        ----------
        pattern : ndarray or Frame
            See `show`.
        stale_s : float, s
        """
        self._feed.put(self._checked(pattern), round(1e9 * stale_s))

    def _checked(self, pattern: Pattern | None) -> NDArray[np.float32] | Frame:
        self._require_life()
        return self._feed.checked(pattern, self.mode)

    def _show(self, show: Show) -> Shown:
        if not 0 < show.level <= 1:
            raise SmartTouchError(
                f"level {show.level:g} must be above 0 and at most 1", about="level"
            )
        with self._one_at_a_time:
            self._require_life()
            self._feed.begin(show)
            show.over.wait()
        self._require_life()
        if show.fault:
            raise LevelNotReachedError(show.fault, about="level")
        if show.ramped_ns and show.seconds:
            self._feed.emit(
                Note(show.time_ns, f"a pattern waited {show.ramped_ns / 1e9:.2f} s for its level")
            )
        return Shown(
            show.time_ns, show.clock_ns, show.board_us, show.sequences, show.pulses,
            0.0 if show.lowest is None else show.lowest, show.ramped_ns / 1e9,
        )  # fmt: skip

    def _require_life(self) -> None:
        if self._failed is not None:
            raise self._failed
        if not self._thread.is_alive() or self._feed.is_over:
            reason = self.statistics.ended or "it is not in its with block"
            raise SmartTouchError(f"the session has ended: {reason}", about="session")

    # -- the user's controls --------------------------------------------------

    @property
    def level(self) -> float:
        """Part of the strongest comfortable current that flows at level 1; changed at any time."""
        return self._feed.controls.state(0).level

    @level.setter
    def level(self, level: float) -> None:
        self._feed.controls.change_level(level - self.level)

    @property
    def mode(self) -> Mode:
        """Afferents that are driven."""
        return self._feed.controls.state(0).mode

    @mode.setter
    def mode(self, mode: Mode | str) -> None:
        offered = self._feed.controls.modes
        chosen = next((each for each in offered if each == mode), None)
        if chosen is None:
            names = ", ".join(str(each) for each in offered)
            raise SmartTouchError(f"mode {mode} is not offered here: choose {names}", about="mode")
        self._feed.controls.choose_mode(chosen)

    def pause(self) -> None:
        """Let no current flow until `resume`."""
        self._feed.controls.pause()

    def resume(self) -> None:
        """Go on; intensity begins at zero."""
        self._feed.controls.resume()

    def stop(self) -> None:
        """End the session: all electrodes are at zero when this returns."""
        self._stop.ask("the session was stopped")
        self._feed.end()


def show_together(
    patterns: Mapping[Session, Pattern], seconds: float, level: float = 1.0
) -> dict[Session, Shown]:
    """Show patterns on several displays at the same time; return how each was shown.

    Levels that are not open are opened first, one after another.

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
    for session, pattern in patterns.items():
        session.rise(level, pattern)
    at_ns = time.monotonic_ns() + _TOGETHER_NS
    with ThreadPoolExecutor(len(patterns)) as pool:
        shown = {
            session: pool.submit(session.show, pattern, seconds, level, at_ns=at_ns)
            for session, pattern in patterns.items()
        }
    return {session: each.result() for session, each in shown.items()}
