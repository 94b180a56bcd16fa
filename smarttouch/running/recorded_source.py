"""Recordings as sources of a run, and controls with the recorded modes and levels."""

import bisect
from dataclasses import replace
from pathlib import Path

from smarttouch.base.afferent import Mode
from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import RecordingError, SourceError
from smarttouch.profile import Profile
from smarttouch.profile.profile import stricter
from smarttouch.running.loop import Controls, ControlState
from smarttouch.running.recording_format import RecordedStep
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.sources.source_contract import Input, Source, Stimulus


def open_recording(rest: str, profile: Profile) -> "RecordingSource":
    """Open the source ``recording:FILE``."""
    if not rest:
        raise SourceError("the source recording needs a file: give recording:FILE.mcap")
    return RecordingSource(RecordedRun(Path(rest)))


class RecordingSource(Source):
    """Frames or stimuli of a recording, with pose and force, at their recorded times.

    An input that was sent as several sequences counts once. Inputs recorded as stale are stale.
    """

    knows_force = True  # the recorded force is used only if no finger can be on the board

    def __init__(self, recording: RecordedRun) -> None:
        super().__init__(recording.path.name)
        self.url = f"recording:{recording.path}"
        self._recording = recording
        self.duration_s: float = recording.seconds
        self._steps = recording.steps()
        self._ahead = next(self._steps, None)
        self._now: RecordedStep | None = None
        self._seen = True
        if self._ahead is None:
            raise SourceError(f"{recording.path} has no steps: nothing can be played")
        if not recording.whole:
            self.notes.append(f"{recording.path} is cut: it is played up to the cut")

    def read(self, time_ns: int) -> Input | None:
        """Return the latest recorded input up to a time; None after the last input."""
        while self._ahead and (not self._now or self._ahead.step.input.time_ns <= time_ns):
            self._advance()
        assert self._now is not None
        if self._ahead is None and time_ns >= _end_ns(self._now):
            return None
        self._seen = True
        recorded = self._now.step.input
        age_ns = max(0, time_ns - recorded.time_ns)
        # Where steps are missing, the input is stale, so that no current flows.
        stale = recorded.stale or time_ns > _end_ns(self._now) + LATE_NS
        number = self.frames - 1
        return replace(recorded, time_ns=time_ns, number=number, age_ns=age_ns, stale=stale)

    def narrowed(self, profile: Profile) -> Profile:
        """Return the profile, with each limit replaced by the recorded limit if that is stricter.

        Raises RecordingError if recorded stimuli are for another number of electrodes.
        """
        was = self._recording.profile
        count, recorded = len(profile.electrodes), len(was.electrodes)
        first = self._ahead or self._now
        if count != recorded and first is not None and isinstance(first.step.input, Stimulus):
            raise RecordingError(
                f"{self.title} has stimuli for {recorded} electrodes, but profile {profile.name} "
                f"has {count}: give a --profile with {recorded} electrodes"
            )
        return stricter(profile, was)

    def close(self) -> None:
        """Close the file; count unread inputs as dropped."""
        self._steps.close()
        self._drop()

    def _advance(self) -> None:
        """Advance to the next step, which may have the same input."""
        before, self._now = self._now, self._ahead
        assert self._now is not None
        recorded, last = self._now.step.input, None if before is None else before.step.input
        # Several images may have the same number, so compare the images, too.
        if last is None or (recorded.number, id(recorded.image)) != (last.number, id(last.image)):
            self._drop()
            self.frames += 1
            self._seen = False
        self._ahead = next(self._steps, None)

    def _drop(self) -> None:
        self.dropped_frames += not self._seen
        self._seen = True


def _end_ns(recorded: RecordedStep) -> int:
    return recorded.step.input.time_ns + 1000 * recorded.step.sequence.period_us


class RecordedControls(Controls):
    """Controls with the recorded modes and levels; the user can still lower the level and pause.

    The user's level scales the recorded level. Raises RecordingError if the board does not offer a
    recorded mode.
    """

    def __init__(
        self, recording: RecordedRun, state: ControlState, modes: tuple[Mode, ...]
    ) -> None:
        super().__init__(state, modes)
        self._times_ns: list[int] = []
        self._recorded: list[ControlState] = []
        for time_ns, step in recording.contents("/step"):
            try:
                recorded = ControlState(Mode(step["mode"]), float(step["level"]))
            except (ValueError, KeyError, TypeError):
                continue
            if not self._recorded or recorded != self._recorded[-1]:
                self._times_ns.append(time_ns)
                self._recorded.append(recorded)
        for recorded in self._recorded:
            if recorded.mode not in modes:
                raise RecordingError(
                    f"{recording.path} has steps in mode {recorded.mode}, which this board does "
                    "not offer: choose a board and profile that do"
                )

    def state(self, time_ns: int) -> ControlState:
        """Return the recorded state at a time of the run, with the user's level and pause."""
        today = super().state(time_ns)
        if not self._recorded:
            return today
        at = max(0, bisect.bisect_right(self._times_ns, time_ns) - 1)
        recorded = self._recorded[at]
        return replace(today, mode=recorded.mode, level=today.level * recorded.level)

    def next_mode(self) -> None:
        """Do nothing, because the recording determines the mode."""

    def choose_mode(self, mode: Mode | str) -> None:
        """Do nothing, because the recording determines the mode."""
