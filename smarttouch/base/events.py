"""Events of a run: typed, with the time at which they happened and words for people.

The words are what recordings and other programs keep; programs go by the types.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from smarttouch.base.afferent import Mode


@dataclass(frozen=True)
class Event:
    """Something that happened in a run, ``time_ns`` after its start."""

    time_ns: int
    reveals: ClassVar[bool] = False
    """Whether it would give the answer of an experiment away to its participant."""
    words: ClassVar[str] = ""
    """What it says, with its fields in braces."""

    def __str__(self) -> str:
        return self.words.format(**vars(self)) or type(self).__name__


@dataclass(frozen=True)
class Note(Event):
    """A sentence that a user should know."""

    text: str
    words: ClassVar[str] = "{text}"


@dataclass(frozen=True)
class Advice(Note):
    """A sentence that a user should read before the run."""


@dataclass(frozen=True)
class Marked(Event):
    """Somebody marked this instant, with a few words."""

    text: str
    words: ClassVar[str] = "mark: {text}"


@dataclass(frozen=True)
class IntensityChanged(Event):
    """The user asked for another intensity, in [0, 1]."""

    level: float
    words: ClassVar[str] = "intensity {level:.2f}"


@dataclass(frozen=True)
class Paused(Event):
    """The user paused the run."""

    words: ClassVar[str] = "paused"


@dataclass(frozen=True)
class Resumed(Event):
    """The user ended a pause."""

    words: ClassVar[str] = "goes on"


@dataclass(frozen=True)
class ModeChanged(Event):
    """The user chose other afferents."""

    mode: Mode
    words: ClassVar[str] = "mode {mode}"


@dataclass(frozen=True)
class InputLost(Event):
    """The image is stale or the force unknown: there is no current."""

    image: bool  # whether it is the image

    def __str__(self) -> str:
        what = "the image is stale" if self.image else "the force is not known"
        return f"{what}: no current"


@dataclass(frozen=True)
class InputRestored(Event):
    """Image and force are known again."""

    words: ClassVar[str] = "image and force are known"


@dataclass(frozen=True)
class FingerLifted(Event):
    """By its voltages, nothing touches the electrodes of the board."""

    words: ClassVar[str] = "the finger is lifted"


@dataclass(frozen=True)
class _Reasoned(Event):
    reason: str
    words: ClassVar[str] = "{reason}"


@dataclass(frozen=True)
class BoardRestarted(_Reasoned):
    """The board was lost or a sequence late, and intensity begins at zero."""


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


Emit = Callable[[Event], None]  # sends an event to the listeners of a run
