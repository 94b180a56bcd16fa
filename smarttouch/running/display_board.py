"""A board with its safety gate, and the profile of the finger on it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from smarttouch.base.stopping import Closing, StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.boards.open import make_board
from smarttouch.boards.shutdown import expect
from smarttouch.profile import Profile
from smarttouch.stimulation.safety_gate import SafetyLimits


class DisplayBoard(Closing):
    """A board that is opened only while it is run, and what stops it; see `Display`."""

    def __init__(
        self,
        url: str | type[Driver] | Board,
        profile: Profile,
        **options: Any,
    ) -> None:
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
