"""Controls that replay the user's input of a recorded run."""

import bisect
from dataclasses import replace

from smarttouch.afferent import Mode
from smarttouch.errors import RecordingError
from smarttouch.recording.chunks import parse_message
from smarttouch.recording.reader import Recording
from smarttouch.running.controls import Controls, ControlState


class RecordedControls(Controls):
    """Modes and levels of a recording; the present user can still lower the level and pause.

    The user's level is a part of the recorded one. Raises RecordingError if the board does not
    offer a mode of the recording.
    """

    def __init__(self, recording: Recording, state: ControlState, modes: tuple[Mode, ...]) -> None:
        super().__init__(state, modes)
        self._times_ns: list[int] = []
        self._recorded: list[ControlState] = []
        for topic, message in recording.messages():
            if topic != "/sequence":
                continue
            try:
                step = parse_message(message.data)
                recorded = ControlState(Mode(step["mode"]), float(step["level"]))
                time_ns = int(step["time_ns"])
            except (ValueError, KeyError, TypeError, OverflowError):
                continue
            if not self._recorded or recorded != self._recorded[-1]:
                self._times_ns.append(time_ns)
                self._recorded.append(recorded)
        for recorded in self._recorded:
            if recorded.mode not in modes:
                raise RecordingError(
                    f"{recording.path} has steps in mode {recorded.mode}, which this board does "
                    "not offer: choose a board and profile that do",
                    about="mode",
                )

    def state(self, time_ns: int) -> ControlState:
        """Return the recorded state at a time of the run, limited by the present user."""
        today = super().state(time_ns)
        if not self._recorded:
            return today
        at = max(0, bisect.bisect_right(self._times_ns, time_ns) - 1)
        recorded = self._recorded[at]
        return replace(today, mode=recorded.mode, level=today.level * recorded.level)

    def next_mode(self) -> None:
        """Do nothing: the modes are the recording's."""

    def choose_mode(self, mode: Mode) -> None:
        """Do nothing: the modes are the recording's."""
