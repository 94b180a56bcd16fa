"""A display: a board with its safety gate, and the finger that is on it."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from smarttouch.base.stopping import Closing, StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.boards.open import default_profile, make_board
from smarttouch.boards.shutdown import expect
from smarttouch.profile import Profile, load_profile
from smarttouch.stimulation.safety_gate import SafetyLimits

if TYPE_CHECKING:
    from smarttouch.running.config import RunConfig
    from smarttouch.running.listener import Listener
    from smarttouch.running.session import Session
    from smarttouch.running.step import StepResult
    from smarttouch.sources.force import ForceSource


class Display(Closing):
    """A board, the profile of the finger on it, and what ends a run on it.

    Its line is open only while it is run; every sequence goes through the safety gate.

    Parameters
    ----------
    url : str, type or Board
        Board, for example ``emulator:`` or ``link:/dev/ttyACM0``, the class of a driver, or a board
        that you made.
    profile : Profile

    Attributes
    ----------
    board : Board

    Raises
    ------
    BoardError
        If there is no such driver, or the profile does not go with it.

    Examples
    --------
    >>> import smarttouch as st
    >>> with st.open_display("simulated:") as display:
    ...     display.on_a_finger
    False
    """

    def __init__(self, url: str | type[Driver] | Board, profile: Profile, **options: Any) -> None:
        limits = SafetyLimits.of(profile)
        if isinstance(url, str):
            board = make_board(url, limits, profile.output, **options)
        elif isinstance(url, Board):
            board = url
        else:
            # Drivers are made as their URLs are opened.
            kind: Any = url
            driver = kind("", SafetyLimits.of(profile), profile.output, **options)
            board = Board(driver, limits, profile.output)
        if not isinstance(url, str):
            kind = type(board.driver)
            url = f"{kind.__module__}.{kind.__qualname__}:"
        self.url: str = url
        self.profile: Profile = profile
        self._stop = StopRequest()
        self.board: Board = board
        # Also without a run: a program may drive the board itself.
        self._stop.always_on_stop(board.halt)
        expect(board)
        self.notes_reported = 0  # number of the board's notes that earlier runs have reported

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url!r}, {self.profile!r})"

    @property
    def on_a_finger(self) -> bool:
        """Whether there may be a finger on it."""
        return self.board.on_a_finger

    @property
    def stopping(self) -> StopRequest:
        """Request that ends whatever runs on it."""
        return self._stop

    def stop(self) -> None:
        """Put all electrodes at zero and end the run, from any thread; it opens no more."""
        self._stop.ask("the display was stopped")

    @contextmanager
    def opened(self, stop: StopRequest) -> Iterator[Board]:
        """Open the board for a block; a stop puts it at zero at once, also while it opens."""
        with stop.on_stop(self.board.halt), self.board:
            yield self.board

    def close(self) -> None:
        """Put all electrodes at zero and release the board; a second call does nothing."""
        self.board.close()

    def session(
        self,
        config: "RunConfig | None" = None,
        *,
        listeners: "Iterable[Listener | Callable[[StepResult], object]]" = (),
        force: "ForceSource | str | None" = None,
        **settings: Any,
    ) -> "Session":
        """Return a session, in whose ``with`` block patterns are shown as a program asks.

        Parameters
        ----------
        config, listeners, force, **settings
            As for `smarttouch.run`.
        """
        from smarttouch.running.config import configured
        from smarttouch.running.session import Session

        return Session(self, configured(config, settings), listeners, force)


def open_display(
    url: str | type[Driver] | Board,
    profile: Profile | str | None = None,
    **options: Any,
) -> Display:
    """Return a display by the URL of its board; its line is opened when it is run.

    Parameters
    ----------
    url : str, type or Board
        ``emulator:``, ``simulated:``, ``link:PORT``, ``kajimoto61:PORT``, ``etactilekit:PORT`` …,
        the class of a driver of your own, or a board that you made.
    profile : Profile or str, optional
        Device and finger; the board's usual one if not given.
    **options
        Of the driver.

    Raises
    ------
    BoardError
        If there is no such driver, or the profile does not go with it.

    Examples
    --------
    >>> import smarttouch as st
    >>> st.open_display("simulated:").profile.name
    'electric-mouse'
    """
    if isinstance(url, str):
        usual = default_profile(url)
    else:
        usual = (url.driver if isinstance(url, Board) else url).default_profile
    return Display(url, load_profile(profile or usual), **options)
