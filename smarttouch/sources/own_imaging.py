"""Imaging of a program's own: a function from frame and electrodes to activation."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import SourceError
from smarttouch.events import Emit
from smarttouch.profile import Profile
from smarttouch.sources.frame import Frame
from smarttouch.sources.input_checks import checked_activation, checked_input
from smarttouch.sources.source import Source, StimulusSource
from smarttouch.sources.stimulus import Stimulus

Imaging = Callable[[Frame, ElectrodeArray], NDArray[np.floating[Any]]]
"""Returns the activation of each class at each electrode, (3, E) in [0, 1], of a frame."""


class OwnImaging(StimulusSource):
    """Stimuli that a function makes of an optical source's frames; recordings keep both."""

    def __init__(self, source: Source, imaging: Imaging, profile: Profile) -> None:
        super().__init__(source.title)
        self.url, self.duration_s, self.canvas = source.url, source.duration_s, source.canvas
        self.knows_force, self.measures_force = source.knows_force, source.measures_force
        self.news, self.patience_ns = source.news, source.patience_ns  # type: ignore[method-assign]
        self.narrowed = source.narrowed  # type: ignore[method-assign]
        self._source, self._imaging, self._electrodes = source, imaging, profile.electrodes
        self._who = getattr(imaging, "__qualname__", type(imaging).__name__)

    def read(self, time_ns: int) -> Stimulus | None:
        """Return what the function makes of the next frame; None at the end."""
        given = self._source.read(time_ns)
        self._count()
        if given is None:
            return None
        electrodes = len(self._electrodes)
        frame = checked_input(given, self.url or self.title, electrodes)
        if not isinstance(frame, Frame):
            raise SourceError(
                f"{self.title} gives tactile images, which need no imaging: leave it out",
                about="imaging",
            )
        activation = self._imaging(frame, self._electrodes)
        return Stimulus(
            checked_activation(activation, self._who, electrodes), frame.time_ns, frame.force_n,
            pose=frame.pose, number=frame.number, age_ns=frame.age_ns, stale=frame.stale,
            image=frame.image,
        )  # fmt: skip

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the source."""
        return self._source.keys

    @property
    def emit(self) -> Emit:
        """Receives the source's events."""
        return self._source.emit

    @emit.setter
    def emit(self, emit: Emit) -> None:
        self._source.emit = emit

    def close(self) -> None:
        """Close the source."""
        self._source.close()
        self._count()
        self.notes = self._source.notes

    def _count(self) -> None:
        self.frames, self.dropped_frames = self._source.frames, self._source.dropped_frames
