"""Drivers of boards by URL, and the check that each keeps the safety gate."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from smarttouch.boards.board import Board
from smarttouch.boards.seal import is_foreign, seal_error, seal_fault
from smarttouch.errors import BoardError
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.device import Output
from smarttouch.registry import find_opener
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.url_options import read_options


def make_board(
    url: str, limits: SafetyLimits, output: Output | None = None, **options: Any
) -> Board:
    """Return the driver for a board's URL, not opened yet; its options may stand in the URL, as in
    ``emulator:?books=FOLDER``."""
    opener, rest = _driver(url)
    rest, from_url = read_options(opener, rest, BoardError, but=("output",))
    given = replace(limits)
    board: Board = opener(rest, limits, output, **{**from_url, **options})
    require_gate(board, limits, given)
    return board


def _of_one_source(found: SafetyLimits, given: SafetyLimits, output: Output | None) -> bool:
    """Return whether limits are those that were given, made narrower for one source."""
    narrower = given.on(output)
    return narrower is not given and found == narrower


def require_gate(board: Board, limits: SafetyLimits, given: SafetyLimits) -> None:
    """Raise BoardError unless a board keeps the limits that its driver was given, unchanged since
    ``given`` was copied, all final methods, and, if a finger may be on it, the machine's clock."""
    fault = seal_fault(board)
    if fault is not None:
        raise fault
    found = board._gate.limits
    # By value too: a driver can change what it was given.
    unchanged = found is limits and found == given
    if not unchanged and not _of_one_source(found, given, board._output):
        raise seal_error(board, "limits", "hand those that it is given to super().__init__")
    # Only without a finger may time be what sequences state.
    if is_foreign(board) and board.on_a_finger and type(board)._time is not Board._time:
        raise seal_error(board, "clock", "leave _time and _clock as they are")


def may_touch_a_finger(url: str) -> bool:
    """Return whether there may be a finger on the board of a URL."""
    return bool(getattr(_driver(url)[0], "on_a_finger", True))


def default_profile(url: str) -> str:
    """Return the name of the shipped profile that goes with a board's URL."""
    return str(getattr(_driver(url)[0], "default_profile", DEFAULT_PROFILE))


def _driver(url: str) -> tuple[Callable[..., Any], str]:
    return find_opener("smarttouch.boards", url, BoardError, Board, ("rest", "limits", "output"))
