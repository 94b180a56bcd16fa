"""Boards made from a URL, such as ``link:/dev/ttyACM0``."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from smarttouch.base.errors import BoardError
from smarttouch.base.urls import Registry, read_options
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.profile import DEFAULT_PROFILE
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

BOARDS = Registry(
    "smarttouch.boards",
    Driver,
    BoardError,
    {
        "emulator": "smarttouch.emulator.drivers:EmulatorDriver",
        "etactilekit": "smarttouch.boards.kits.etactilekit:ETactileKitDriver",
        "kajimoto61": "smarttouch.boards.kits.kajimoto61:Kajimoto61Driver",
        "link": "smarttouch.boards.link.link_driver:LinkDriver",
        "memory": "smarttouch.emulator.drivers:MemoryDriver",
        "simulated": "smarttouch.emulator.drivers:SimulatedDriver",
    },
)
_WITHOUT_FINGER: dict[str, dict[str, Any]] = {
    "emulator": {"on_a_finger": False},
    "memory": {"on_a_finger": False, "claimed_time": True},
    "simulated": {"on_a_finger": False, "claimed_time": True, "simulated_time": True},
}
"""Arguments of `Board` for the kinds of boards that no finger can touch. All other kinds keep the
defaults of `Board`: a finger may be on the board."""


def make_board(
    url: str, limits: SafetyLimits, output: Output | None = None, **options: Any
) -> Board:
    """Return a closed board for a URL. The URL may contain options of the driver, as in
    ``emulator:?books=FOLDER``, and ``record=FILE`` to record the bytes of the line."""
    opener, rest = BOARDS.find(url)
    rest, from_url = read_options(opener, rest, BoardError, ("output",), record=Path)
    path = from_url.pop("record", None)
    driver: Driver = opener(rest, replace(limits), output, **{**from_url, **options})
    BOARDS.require_kind(driver, url)
    board = Board(driver, limits, output, **_WITHOUT_FINGER.get(url.partition(":")[0], {}))
    if path and (driver.port is None or path.exists() or not path.parent.is_dir()):
        needs = "the file must be new, its folder must exist, and the board must have a port"
        raise BoardError(f"cannot record {url} to {path}: {needs}")
    board._line.recording = path
    return board


def may_touch_a_finger(url: str) -> bool:
    """Return whether a finger may be on the board of a URL."""
    BOARDS.find(url)
    return url.partition(":")[0] not in _WITHOUT_FINGER


def default_profile(url: str) -> str:
    """Return the name of the default profile for a board's URL."""
    return str(getattr(BOARDS.find(url)[0], "default_profile", DEFAULT_PROFILE))
