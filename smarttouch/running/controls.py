"""The user's own controls: intensity, mode and pause, changed while it runs."""

from dataclasses import dataclass, replace

from smarttouch.afferent import Mode

STEP = 0.05
"""Of one press of a key, in parts of the strongest."""


@dataclass(frozen=True)
class ControlState:
    """State of the user's controls.

    Attributes
    ----------
    mode : Mode
    level : float, in [0, 1]
        Of the strongest comfortable current: the subject's own control.
    paused : bool
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

    Parameters
    ----------
    state : ControlState
        To begin with.
    modes : tuple of Mode
        What `next_mode` goes through.

    Attributes
    ----------
    most : float, in [0, 1]
        No level is raised above it.
    """

    most = 1.0

    def __init__(self, state: ControlState, modes: tuple[Mode, ...] = ()) -> None:
        self._state, self._modes = state, modes or (state.mode,)

    def state(self, _time_ns: int) -> ControlState:
        """Return the state at a time of the run."""
        return self._state

    def change_level(self, by: float) -> None:
        """Raise or lower the level, from 0 to the most that is allowed."""
        level = min(self.most, max(0.0, round(self._state.level + by, 6)))
        self._state = replace(self._state, level=level)

    def silence(self) -> None:
        """Level 0 at once."""
        self._state = replace(self._state, level=0.0)

    def toggle_pause(self) -> None:
        """Pause, or go on from zero intensity."""
        self._state = replace(self._state, paused=not self._state.paused)

    def next_mode(self) -> None:
        """Go to the next mode that is offered."""
        at = self._modes.index(self._state.mode)
        self._state = replace(self._state, mode=self._modes[(at + 1) % len(self._modes)])
