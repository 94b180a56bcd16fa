"""Contract of a source: optical ones give frames, stimulus sources give stimuli."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol

from smarttouch.events import Emit, emit_nowhere
from smarttouch.profile import Profile
from smarttouch.sources.device import Device
from smarttouch.sources.frame import Frame
from smarttouch.sources.stimulus import Input, Stimulus


class Canvas(Protocol):
    """Part of a source that a page of the window draws on; ``changes`` counts what it shows."""

    changes: int

    def draw(self, words: str) -> None:
        """Do what a page asks for; ValueError if it cannot be understood."""

    def message(self) -> dict[str, Any]:
        """Return all that a page shows of it, with ``changes``; for JSON."""


class Source(Device, ABC):
    """Base of all sources.

    Everything that a source delivers is either read or dropped: at the end ``frames``
    is the number of distinct inputs read plus ``dropped_frames``.
    """

    canvas: Canvas | None = None
    """What a page of the window draws on, if anything."""
    duration_s: float | None = None
    """Duration; None if it never ends by itself."""
    ended: ClassVar[str] = "the source has ended"
    """Message at its end."""
    emit: Emit = staticmethod(emit_nowhere)
    """Receives events of the source; set by the run."""
    knows_force: bool = False
    """Whether its inputs have a force."""
    measures_force: bool = False
    """Whether that force is measured on a finger during the run. Any other force counts only on
    boards that no finger can touch."""
    frames: int = 0
    """Distinct frames or stimuli that it delivered."""
    dropped_frames: int = 0
    """Frames or stimuli that arrived but were never read."""
    keys_help: ClassVar[str] = ""
    """Help text for its keys."""

    news: threading.Event | None = None
    """Set when it has something new, for sources that `patience_ns` lets the loop wait for."""

    def patience_ns(self, time_ns: int) -> int:
        """Return how long the next read may wait for `news`, ns."""
        return 0

    def narrowed(self, profile: Profile) -> Profile:
        """Return the profile used to plan this source's stimulation; never with wider limits."""
        return profile

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Functions of single keys, callable from any thread; none if it has no controls."""
        return {}

    @abstractmethod
    def read(self, time_ns: int) -> Input | None:
        """Return the input at ``time_ns`` since the start; None at the end."""


class OpticalSource(Source):
    """Source of frames, which imaging turns into tactile images."""

    @abstractmethod
    def read(self, time_ns: int) -> Frame | None:
        """Return the frame at ``time_ns`` since the start; None at the end."""


class StimulusSource(Source):
    """Source of stimuli, which also chooses the classes that they drive."""

    @abstractmethod
    def read(self, time_ns: int) -> Stimulus | None:
        """Return the stimulus at ``time_ns`` since the start; None at the end."""
