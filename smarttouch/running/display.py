"""Displays, and sessions in which a program shows patterns."""

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Self

from smarttouch.base.errors import BoardError, BoardStoppedError, SmartTouchError
from smarttouch.base.stopping import Closing, StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.open import default_profile, make_board
from smarttouch.boards.shutdown import current_command, expect
from smarttouch.profile import Profile, load_profile
from smarttouch.running.config import RunConfig, configured
from smarttouch.running.loop import Loop
from smarttouch.running.pattern_program import CANCELED, Pattern, Program, Shown
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step_records import Listener, StepResult
from smarttouch.sources.force import ForceSource
from smarttouch.stimulation.safety_gate import SafetyLimits


class Display(Closing):
    """Board with the profile of the finger on it.

    The board is open only during runs. All sequences pass the safety gate.

    Parameters
    ----------
    url : str or Board
        URL of a board, for example ``emulator:`` or ``link:/dev/ttyACM0``, or a `Board` object.
    profile : Profile

    Attributes
    ----------
    board : Board

    Raises
    ------
    BoardError
        If there is no such driver, or the profile does not fit the board.

    Examples
    --------
    >>> import smarttouch as st
    >>> with st.open_display("simulated:") as display:
    ...     display.on_a_finger
    False
    """

    def __init__(self, url: str | Board, profile: Profile, **options: Any) -> None:
        if isinstance(url, Board):
            kind = type(url.driver)
            board, url = url, f"{kind.__module__}.{kind.__qualname__}:"
        else:
            board = make_board(url, SafetyLimits.of(profile), profile.output, **options)
        self.url: str = url
        self.profile: Profile = profile
        self._stop = StopRequest()
        self.board: Board = board
        # Halt the board on a stop even without a run: a program may drive the board directly.
        self._stop.always_on_stop(board.halt)
        expect(board)
        self.notes_reported = 0  # number of notes reported by earlier runs

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r}, {self.profile!r})"

    @property
    def on_a_finger(self) -> bool:
        """Whether a finger may be on the board."""
        return self.board.on_a_finger

    @property
    def stopping(self) -> StopRequest:
        """Stop request, which ends all runs on this display."""
        return self._stop

    def stop(self) -> None:
        """Set all electrodes to zero and end the run, from any thread. The display cannot be opened
        again."""
        self._stop.ask("the display was stopped")

    @contextmanager
    def opened(self, stop: StopRequest | None = None) -> Iterator[Board]:
        """Open the board for a ``with`` block. A stop sets it to zero at once, also during opening.

        After a signal such as SIGINT, sending raises BoardStoppedError, which ends the block.
        """
        command = current_command()
        stop, before = stop or command.stop, command.orderly
        command.orderly = before or stop is command.stop
        try:
            with contextlib.ExitStack() as stack:
                stack.enter_context(stop.on_stop(self.board.halt))
                try:
                    stack.enter_context(self.board)
                except BoardError as error:
                    if stop is not command.stop or not command.number:
                        raise
                    # A signal caused this failure, so report a stop instead of a fault.
                    raise BoardStoppedError(str(error)) from None
                yield self.board
        finally:
            command.orderly = before

    def close(self) -> None:
        """Set all electrodes to zero and release the board; a second call does nothing."""
        self.board.close()

    def session(
        self,
        config: RunConfig | None = None,
        *,
        listeners: Iterable[Listener | Callable[[StepResult], object]] = (),
        force: ForceSource | str | None = None,
        **settings: Any,
    ) -> "Session":
        """Return a session in which a program shows patterns, for a ``with`` block.

        Parameters
        ----------
        config, listeners, force, **settings
            See `smarttouch.run`.
        """
        return Session(self, configured(config, settings), listeners, force)


def open_display(
    url: str | Board,
    profile: Profile | str | None = None,
    **options: Any,
) -> Display:
    """Return a display for a board; the board is opened later, by each run.

    Parameters
    ----------
    url : str or Board
        ``emulator:``, ``simulated:``, ``link:PORT``, ``kajimoto61:PORT``, ``etactilekit:PORT`` …,
        or a `Board` object.
    profile : Profile or str, optional
        Device and finger; by default the board's own profile.
    **options
        Options of the driver.

    Raises
    ------
    BoardError
        If there is no such driver, or the profile does not fit the board.

    Examples
    --------
    >>> import smarttouch as st
    >>> st.open_display("simulated:").profile.name
    'electric-mouse'
    """
    usual = url.driver.default_profile if isinstance(url, Board) else default_profile(url)
    return Display(url, load_profile(profile or usual), **options)


class Session(Program):
    """Session of a display, in which a program shows patterns; made by `Display.session`.

    The board is open in the ``with`` block, and at zero after the block. Methods may be called from
    any thread.

    Attributes
    ----------
    statistics : RunStatistics
        Statistics of all sequences that were sent; complete after the block.

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
        from smarttouch.running.runner import Runner

        super().__init__(display.profile)
        self._display, self._stop = display, StopRequest()
        runner = Runner(self, display, config, force=force, listeners=listeners, stop=self._stop)
        self.statistics: RunStatistics = runner.statistics
        self._run: AbstractContextManager[Loop] = runner.running()

    def __repr__(self) -> str:
        return f"Session({self._display!r}, {'closed' if self._loop is None else 'open'})"

    def __enter__(self) -> Self:
        if self.statistics.ended:
            raise SmartTouchError("a session can be entered only once: create another one")
        self._loop = self._run.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        kind, error, _ = exception
        if isinstance(kind, type) and error is not self._failed:
            # The program failed: set the board to zero at once.
            self._stop.ask(f"the program raised {kind.__name__}")
        loop, self._outside = self._loop, "the session's `with` block has ended"
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
    """Show patterns on several displays at the same time; return the result of each session.

    First the ramps of all displays rise to the level at the same time.

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
    from concurrent.futures import ThreadPoolExecutor

    canceled = threading.Event()
    with ThreadPoolExecutor(max(1, len(patterns)), "show", CANCELED.set, (canceled,)) as pool:
        try:
            rising = [pool.submit(session.rise, level, patterns[session]) for session in patterns]
            for opened in rising:
                opened.result()
            showing = {
                session: pool.submit(session.show, pattern, seconds, level)
                for session, pattern in patterns.items()
            }
            return {session: shown.result() for session, shown in showing.items()}
        except BaseException:
            canceled.set()
            raise
