"""What a run is asked to be, whichever command asks."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from smarttouch.boards.board import Board, may_touch_a_finger
from smarttouch.cli.files import require_folder
from smarttouch.controls import Controls, Wish
from smarttouch.errors import SmartTouchError
from smarttouch.imaging.mapping import Tone
from smarttouch.live import Sent
from smarttouch.primary import Mode
from smarttouch.stimulation.frames import NO_SHARING, Sharing

_TELL_ALL = ("emulator:", "simulated:")
"""Boards that report every pulse."""


@dataclass
class Plan:
    """What a run is asked to be."""

    sensor_url: str
    board_url: str
    mode: Mode
    rate_hz: float | None = None
    seconds: float | None = None
    level: float | None = None
    softness: float | None = None
    light_on_dark: bool = False
    force_url: str | None = None
    measure: bool = False
    hold: str | None = None
    balance: bool = False
    sharing: Sharing = NO_SHARING
    """Classes whose points share slots."""
    tone: Tone | None = None
    felt: Path | None = None
    frames: Path | None = None
    record: Path | None = None
    markers: bool = False
    vibrators_url: str | None = None
    json_file: Path | None = None
    quiet: bool = False
    seed: int = 0
    subject: str = ""
    note: str = ""
    controls: Callable[[Wish, tuple[Mode, ...]], Controls] = field(default=Controls)
    attend: Callable[[Board], Callable[[Sent], None]] | None = None
    """Given the open board, returns who is told of every step."""

    def __post_init__(self) -> None:
        for output in (self.felt, self.record, self.json_file):
            require_folder(output)
        if self.felt is not None and not self.board_url.startswith(_TELL_ALL):
            raise SmartTouchError(
                f"--felt needs a board that reports every pulse, and {self.board_url!r} does not: "
                "use --board emulator:"
            )
        for name, value in (("--intensity", self.level), ("--softness", self.softness)):
            if value is not None and not 0 <= value <= 1:
                raise SmartTouchError(f"{name} {value:g} must be from 0 to 1")
        if self.hold is not None and self.sharing.primaries:
            raise SmartTouchError(
                "--hold learns from the voltage of each point, and several share a slot: choose "
                "--scan points"
            )
        if self.seconds is not None and not self.seconds > 0:
            raise SmartTouchError(f"--seconds {self.seconds:g} must be above 0")

    def require_a_level(self) -> None:
        """Raise if nobody says how strong it may be on a board that a finger may be on."""
        if self.level is None and self.on_a_finger and not sys.stdin.isatty():
            raise SmartTouchError(
                "there is no keyboard to turn the current up with, and a finger may be on the "
                "board: say how strong it is to become with --intensity, for example 0.3"
            )

    @property
    def first_level(self) -> float:
        """Intensity to begin with: on a real board nothing, where someone can turn it up.

        Where nobody can, it is what was asked for, to which it rises from zero.
        """
        if self.on_a_finger and sys.stdin.isatty():
            return 0.0
        return 1.0 if self.level is None else self.level

    @property
    def most(self) -> float:
        """Intensity that keys cannot raise it above."""
        if self.level is None or not self.on_a_finger:
            return 1.0
        return self.level

    @property
    def on_a_finger(self) -> bool:
        """Whether the board may have a finger on it."""
        return may_touch_a_finger(self.board_url)
