"""A recording as a sensor: what was seen and how hard the finger pressed, once more."""

from dataclasses import replace
from pathlib import Path

from smarttouch.errors import SensorError
from smarttouch.profile import Profile
from smarttouch.recording.decoder import RecordedStep
from smarttouch.recording.reader import Recording
from smarttouch.sources.frame import Frame, Sensor


def open_recording(rest: str, profile: Profile, *, unpaced: bool = False) -> "RecordingSensor":
    """Open ``recording:FILE``; options are those of `RecordingSensor`.

    Raises
    ------
    SensorError
        If no file is named.
    RecordingError
        If there is no such recording.
    """
    if not rest:
        raise SensorError(
            "recording: needs a file: give recording:FILE.mcap",
            about="file",
            problem="missing",
            remedy="recording:FILE.mcap",
        )
    return RecordingSensor(Recording(Path(rest)), unpaced)


class RecordingSensor(Sensor):
    """Frames of a recording with pose and force, at the times at which they were felt.

    An image that was felt for several sequences counts once. An image that was
    stale stays so.

    Parameters
    ----------
    recording : Recording
        Whose frames.
    unpaced : bool
        Give the next step at each look, however long that takes.
    """

    knows_force = True

    def __init__(self, recording: Recording, unpaced: bool = False) -> None:
        super().__init__(recording.path.name)
        self.duration_s = recording.duration_s
        self._unpaced = unpaced
        self._steps = recording.steps()
        self._ahead = next(self._steps, None)
        self._now: RecordedStep | None = None
        self._seen = True
        if self._ahead is None:
            raise SensorError(
                f"{recording.path} holds no frames: nothing can be played from it",
                about="file",
                problem="empty",
                value=recording.path,
            )
        if not recording.whole:
            self.notes.append(f"{recording.path} is cut: it is played as far as it goes")

    def read(self, time_ns: int) -> Frame | None:
        """Return the newest recorded frame that is not later than a time; None after the last."""
        if self._unpaced:
            if self._ahead is None:
                return None
            self._advance()
        else:
            while self._ahead is not None and self._is_due(self._ahead, time_ns):
                self._advance()
            if self._ahead is None and self._now is not None and time_ns >= _end_ns(self._now):
                return None
        assert self._now is not None
        self._seen = True
        frame = self._now.step.frame
        age_ns = 0 if self._unpaced else max(0, time_ns - frame.time_ns)
        number = self.frames - 1
        return replace(frame, time_ns=time_ns, number=number, age_ns=age_ns)

    def close(self) -> None:
        """Let go of the file; an image that was passed and not read is dropped."""
        self._steps.close()
        self._drop()

    def _is_due(self, ahead: RecordedStep, time_ns: int) -> bool:
        return self._now is None or ahead.step.frame.time_ns <= time_ns

    def _advance(self) -> None:
        """Go to the next step; its image may be the same."""
        before, self._now = self._now, self._ahead
        assert self._now is not None
        if before is None or self._now.step.frame.image is not before.step.frame.image:
            self._drop()
            self.frames += 1
            self._seen = False
        self._ahead = next(self._steps, None)

    def _drop(self) -> None:
        self.dropped_frames += not self._seen
        self._seen = True


def _end_ns(recorded: RecordedStep) -> int:
    return recorded.step.frame.time_ns + 1000 * recorded.step.sequence.period_us
