"""Events of a run: one class for each kind, with time and text.

Recordings store the text. Programs should distinguish events by class.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from smarttouch.base.afferent import Mode


@dataclass(frozen=True)
class Event:
    """Event that happened ``time_ns`` after the start of a run."""

    time_ns: int
    reveals: ClassVar[bool] = False
    """Whether the text reveals the right answer of a trial and must be hidden from participants."""
    words: ClassVar[str] = ""
    """Format string of the text; names in braces are attributes of the event."""

    def __str__(self) -> str:
        return self.words.format(**vars(self)) or type(self).__name__


@dataclass(frozen=True)
class Note(Event):
    """A sentence for the user."""

    text: str
    words: ClassVar[str] = "{text}"


@dataclass(frozen=True)
class Advice(Note):
    """A sentence for the user to read before the run."""


@dataclass(frozen=True)
class Marked(Event):
    """The user marked this moment with a text."""

    text: str
    words: ClassVar[str] = "mark: {text}"


@dataclass(frozen=True)
class IntensityChanged(Event):
    """The user changed the intensity; ``level`` is the new one, in [0, 1]."""

    level: float
    words: ClassVar[str] = "intensity {level:.2f}"


@dataclass(frozen=True)
class Paused(Event):
    """The user paused the run."""

    words: ClassVar[str] = "paused"


@dataclass(frozen=True)
class Resumed(Event):
    """The user ended a pause."""

    words: ClassVar[str] = "resumed"


@dataclass(frozen=True)
class ModeChanged(Event):
    """The user chose another mode."""

    mode: Mode
    words: ClassVar[str] = "mode {mode}"


@dataclass(frozen=True)
class InputLost(Event):
    """The image is stale or the force unknown, so no current flows."""

    image: bool  # True: the image is stale; False: the force is unknown

    def __str__(self) -> str:
        what = "the image is stale" if self.image else "the force is not known"
        return f"{what}: no current"


@dataclass(frozen=True)
class InputRestored(Event):
    """Image and force are known again."""

    words: ClassVar[str] = "image and force are known again"


@dataclass(frozen=True)
class FingerLifted(Event):
    """The board's voltages show that nothing touches the electrodes."""

    words: ClassVar[str] = "the finger is lifted"


@dataclass(frozen=True)
class _Reasoned(Event):
    reason: str
    words: ClassVar[str] = "{reason}"


@dataclass(frozen=True)
class BoardRestarted(_Reasoned):
    """The board was lost or a sequence was late, so the ramp restarts at zero."""


@dataclass(frozen=True)
class RunFailed(_Reasoned):
    """An error ends the run."""


@dataclass(frozen=True)
class RunEnded(_Reasoned):
    """The run is over."""


@dataclass(frozen=True)
class TrialEvent(Note):
    """A trial of an experiment was presented, repeated or answered."""

    reveals: ClassVar[bool] = True


Emit = Callable[[Event], None]  # passes an event to the listeners of a run
