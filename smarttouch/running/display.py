"""A display: a board with its safety gate, and the finger that is on it."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Unpack

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import Closing, StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.open import default_profile, make_board, require_gate
from smarttouch.profile import Profile, load_profile
from smarttouch.stimulation.safety_gate import SafetyLimits

if TYPE_CHECKING:
    from smarttouch.running.config import RunOptions
    from smarttouch.running.listener import Listener
    from smarttouch.running.session import Session
    from smarttouch.running.step import StepResult
    from smarttouch.sources.force import ForceSource


class Display(Closing):
    """A board, the profile of the finger on it, and what ends a run on it.

    Its line is open only while it is run; every sequence goes through the safety gate.

    Parameters
    ----------
    url : str or type
        Board, for example ``emulator:`` or ``link:/dev/ttyACM0``, or a driver's class.
    profile : Profile
    vibrators_url : str, optional
        Mechanical vibrators, which shake PC in place of current.

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

    def __init__(
        self,
        url: str | type[Board],
        profile: Profile,
        vibrators_url: str | None = None,
        **options: Any,
    ) -> None:
        limits = SafetyLimits.of(profile)
        if isinstance(url, str):
            board = make_board(url, limits, profile.output, **options)
        else:
            # Drivers are made as their URLs are opened, and `Board` itself by its limits alone.
            given = SafetyLimits.of(profile)
            board = url("", limits, profile.output, **options)  # type: ignore[call-arg, arg-type]
            require_gate(board, limits, given)
            url = f"{url.__module__}.{url.__qualname__}:"
        self.url: str = url
        self.profile: Profile = profile
        self.vibrators_url: str | None = vibrators_url
        self._stop = StopRequest()
        if vibrators_url is not None:
            from smarttouch.boards.vibrators.vibrator_board import HybridBoard, make_vibrators

            shaking = make_vibrators(vibrators_url, limits, profile.electrodes)
            board = HybridBoard(board, shaking)
        elif url.startswith("vibrators:"):
            raise SmartTouchError(
                "vibrators make no current, and shake only what PC is to feel: give them beside a "
                "board of electrodes",
                about="board",
                remedy="vibrators",
            )
        self.board: Board = board
        # With no run, too: a program may drive the board itself.
        self._stop.always_on_stop(board.halt)
        self.notes_reported = 0
        """Number of the board's notes that earlier runs have reported."""

    def __repr__(self) -> str:
        return f"Display({self.url!r}, {self.profile!r})"

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

    def session(
        self,
        *,
        mode: Mode | str = Mode.RA,
        listeners: "Iterable[Listener | Callable[[StepResult], object]]" = (),
        force: "ForceSource | str | None" = None,
        **settings: "Unpack[RunOptions]",
    ) -> "Session":
        """Return a session, in whose ``with`` block patterns are shown as a program asks.

        Parameters
        ----------
        mode, listeners, force, **settings
            As for `smarttouch.run`.
        """
        from smarttouch.running.config import RunConfig
        from smarttouch.running.session import Session

        return Session(self, RunConfig(mode=mode, **settings), listeners, force)

    def close(self) -> None:
        """Put all electrodes at zero and let go of the board; a second time does nothing."""
        self.board.close()


def open_display(
    url: str | type[Board],
    profile: Profile | str | None = None,
    *,
    vibrators_url: str | None = None,
    **options: Any,
) -> Display:
    """Return a display by the URL of its board; its line is opened when it is run.

    Parameters
    ----------
    url : str or type
        ``emulator:``, ``simulated:``, ``link:PORT``, ``kajimoto61:PORT``, ``etactilekit:PORT`` …,
        or the class of a driver of your own.
    profile : Profile or str, optional
        Device and finger; the board's usual one if not given.
    vibrators_url : str, optional
        Mechanical vibrators, which shake PC in place of current.
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
    if not isinstance(profile, Profile):
        profile = load_profile(
            profile or (default_profile(url) if isinstance(url, str) else url.default_profile)
        )
    return Display(url, profile, vibrators_url, **options)
