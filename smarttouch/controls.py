"""The user's own controls: intensity, mode and pause, changed while it runs."""

from dataclasses import dataclass, replace

from smarttouch.primary import Mode

STEP = 0.05
"""Of one press of a key, in parts of the strongest."""


@dataclass(frozen=True)
class Wish:
    """What the user wants now.

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
        return 0.0 if self.paused else self.level


class Controls:
    """Holds the user's wish; changed from any thread, read by the loop.

    Parameters
    ----------
    wish : Wish
        To begin with.
    modes : tuple of Mode
        What `next_mode` goes through.

    Attributes
    ----------
    most : float, in [0, 1]
        No level is raised above it.
    """

    most = 1.0

    def __init__(self, wish: Wish, modes: tuple[Mode, ...] = ()) -> None:
        self._wish, self._modes = wish, modes or (wish.mode,)

    def wish(self, _time_ns: int) -> Wish:
        """Return what the user wants at a time of the run."""
        return self._wish

    def change_level(self, by: float) -> None:
        """Raise or lower the level, from 0 to the most that is allowed."""
        level = min(self.most, max(0.0, round(self._wish.level + by, 6)))
        self._wish = replace(self._wish, level=level)

    def silence(self) -> None:
        """Level 0 at once."""
        self._wish = replace(self._wish, level=0.0)

    def toggle_pause(self) -> None:
        """Pause, or go on from zero intensity."""
        self._wish = replace(self._wish, paused=not self._wish.paused)

    def next_mode(self) -> None:
        """Go to the next mode that is offered."""
        at = self._modes.index(self._wish.mode)
        self._wish = replace(self._wish, mode=self._modes[(at + 1) % len(self._modes)])
