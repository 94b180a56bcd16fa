"""Drivers of boards by URL, and the check that each keeps the safety gate."""

from collections.abc import Callable
from typing import Any

from smarttouch.boards.board import Board
from smarttouch.clock import MonotonicClock
from smarttouch.errors import BoardError
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.device import Output
from smarttouch.registry import final_names, find_opener
from smarttouch.stimulation.safety import SafetyGate, SafetyLimits
from smarttouch.url_options import read_options


def make_board(
    url: str, limits: SafetyLimits, output: Output | None = None, **options: Any
) -> Board:
    """Return the driver for a board's URL, not opened yet.

    Options of the driver may stand in the URL, as in ``emulator:?books=FOLDER``.

    Raises
    ------
    BoardError
        If no driver has that name, it has no such option, or that of another package does not
        keep the contract.
    """
    opener, rest = _driver(url)
    rest, told = read_options(opener, rest, BoardError, but=("output",))
    board: Board = opener(rest, limits, output, **{**told, **options})
    require_gate(board, limits)
    return board


def _of_one_source(found: SafetyLimits, given: SafetyLimits, output: Output | None) -> bool:
    """Return whether limits are those that were given, made narrower for one source."""
    narrower = given.on(output)
    return narrower is not given and found == narrower


def require_gate(board: Board, limits: SafetyLimits) -> None:
    """Raise unless a board has the gate of these limits, on the machine's clock.

    Raises
    ------
    BoardError
        If its driver has other limits, another gate, or something in place of a method that
        is final; or if there may be a finger on it and it has another clock.
    """
    kind = type(board)
    gate = getattr(board, "_gate", None)
    about = ""
    if type(gate) is not SafetyGate or "prove" in vars(gate):
        about, remedy = "gate", "leave _gate as it is"
    elif gate.limits is not limits and not _of_one_source(gate.limits, limits, board._output):
        about, remedy = "limits", "hand those that it is given to super().__init__"
    elif put := [name for name in final_names(Board) if name in vars(board)]:
        about, remedy = put[0], "implement the underscored methods of Board instead"
    elif (
        # Only where no finger can be is time what sequences claim.
        board.on_a_finger
        and kind.__module__.partition(".")[0] != "smarttouch"
        and (kind._time is not Board._time or type(board.clock) is not MonotonicClock)
    ):
        about, remedy = "clock", "leave _time and _clock as they are"
    if about:
        raise BoardError(
            f"{kind.__name__} goes around the safety gate by its {about}: {remedy}",
            about=about,
            problem="replaced",
            value=kind.__name__,
        )


def may_touch_a_finger(url: str) -> bool:
    """Return whether there may be a finger on the board of a URL."""
    return bool(getattr(_driver(url)[0], "on_a_finger", True))


def default_profile(url: str) -> str:
    """Return the name of the shipped profile that goes with a board's URL."""
    return str(getattr(_driver(url)[0], "default_profile", DEFAULT_PROFILE))


def _driver(url: str) -> tuple[Callable[..., Any], str]:
    return find_opener("smarttouch.boards", url, BoardError, Board, ("rest", "limits", "output"))
