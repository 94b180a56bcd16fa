"""A board with its safety gate, and the profile of the finger on it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import Closing, StopRequest
from smarttouch.boards.board import Board
from smarttouch.boards.open import make_board, require_gate
from smarttouch.profile import Profile
from smarttouch.stimulation.safety_gate import SafetyLimits


class DisplayBoard(Closing):
    """A board that is opened only while it is run, and what stops it; see `Display`."""

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
            # `Board` itself is made by its limits alone; drivers as their URLs are opened.
            driver: Any = url
            given = SafetyLimits.of(profile)
            board = driver("", limits, profile.output, **options)
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
                "vibrators drive PC alone and make no current: give them beside a board of "
                "electrodes"
            )
        self.board: Board = board
        # Also without a run: a program may drive the board itself.
        self._stop.always_on_stop(board.halt)
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
