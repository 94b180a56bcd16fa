"""The user's own controls: intensity, mode and pause, changed while it runs."""

import threading
from dataclasses import dataclass, replace
from typing import Any

from smarttouch.afferent import Mode

STEP = 0.05
"""Change of level by one press of a key."""


@dataclass(frozen=True)
class ControlState:
    """State of the user's controls; ``level`` is a part of the strongest comfortable current, [0,
    1].
    """

    mode: Mode
    level: float = 1.0
    paused: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.level <= 1:
            raise ValueError(f"a level of {self.level} is not between 0 and 1")

    @property
    def current_level(self) -> float:
        """Level that flows: zero while paused."""
        return 0.0 if self.paused else self.level


class Controls:
    """Intensity, mode and pause as the user sets them; changed from any thread, read by the loop.

    No level is raised above ``most``; `next_mode` goes through ``modes``.
    """

    most = 1.0

    def __init__(self, state: ControlState, modes: tuple[Mode, ...] = ()) -> None:
        self._state, self.modes = state, modes or (state.mode,)
        # A change that another thread makes in between must not be lost, least of all a pause.
        self._lock = threading.RLock()

    def state(self, _time_ns: int) -> ControlState:
        """Return the state at a time of the run."""
        return self._state

    def change_level(self, by: float) -> None:
        """Raise or lower the level, from 0 to the most that is allowed."""
        with self._lock:
            level = min(self.most, max(0.0, round(self._state.level + by, 6)))
            self._change(level=level)

    def silence(self) -> None:
        """Set the level to 0 at once."""
        self._change(level=0.0)

    def pause(self) -> None:
        """Set the level that flows to 0 at once, until `resume`."""
        self._change(paused=True)

    def resume(self) -> None:
        """Go on from zero intensity."""
        self._change(paused=False)

    def toggle_pause(self) -> None:
        """Pause, or go on from zero intensity."""
        with self._lock:
            self._change(paused=not self._state.paused)

    def next_mode(self) -> None:
        """Go to the next mode that is offered."""
        with self._lock:
            at = self.modes.index(self._state.mode)
            self._change(mode=self.modes[(at + 1) % len(self.modes)])

    def choose_mode(self, mode: Mode) -> None:
        """Go to one of the modes that are offered; to no other."""
        if mode in self.modes:
            self._change(mode=mode)

    def _change(self, **changes: Any) -> None:
        with self._lock:
            self._state = replace(self._state, **changes)
