"""Reader of recordings, also of those that were cut or damaged."""

import json
from collections.abc import Generator, Iterator
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.records import Message
from pydantic import ValidationError

from smarttouch.base.errors import ProfileError, RecordingError
from smarttouch.base.removed import without_removed
from smarttouch.profile import Profile
from smarttouch.running.mcap_file import McapFile
from smarttouch.running.recording_format import FORMAT, METADATA, RecordedSettings, read_settings
from smarttouch.running.step_decoder import RecordedStep, StepDecoder
from smarttouch.stimulation.sequence_limits import LONGEST_PERIOD_US


class Recording(McapFile):
    """A recording of a run, also one that was cut or damaged.

    ``about`` is the result of `about_run`; ``broken_steps`` counts incomplete steps of the last
    reading. Raises RecordingError if there is no such file, or it is not from SmartTouch.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.about: dict[str, str] = self.metadata.get(METADATA, {})
        self.broken_steps: int = 0
        found = self.about.get("format")
        if found is None:
            message = f"{path} has nothing of a run: it is no recording of SmartTouch"
            raise RecordingError(message)
        if found != FORMAT:
            raise RecordingError(
                f"{path} is a recording of format {found!r}, this version reads {FORMAT}: use the "
                "version that made it"
            )

    @property
    def whole(self) -> bool:
        """True if it ended properly, and everything read so far was intact."""
        return self.ended and not self._bad_at and not self.broken_steps

    @cached_property
    def started_unix_ns(self) -> int:
        """Start of the run, ns since 1970."""
        try:
            return int(self.about["started_unix_ns"])
        except (KeyError, ValueError):
            message = f"{self.path} does not say when its run began"
            raise RecordingError(message) from None

    @property
    def started(self) -> datetime:
        """Start of the run, UTC."""
        try:
            return datetime.fromtimestamp(self.started_unix_ns / 1e9, UTC)
        except (OverflowError, ValueError, OSError):
            raise RecordingError(
                f"{self.path} began at an impossible time, {self.started_unix_ns} ns"
            ) from None

    @property
    def duration_s(self) -> float:
        """Time from the start of the run to the last message, s."""
        return max(0, self._last_ns - self.started_unix_ns) / 1e9

    @cached_property
    def profile(self) -> Profile:
        """Device and finger of the run."""
        try:
            return Profile.model_validate(
                without_removed(json.loads(self.about.get("profile", "")))
            )
        except (ValueError, AttributeError, ProfileError) as error:
            first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
            message = f"the profile in {self.path} is not one of this version's: {first}"
            raise RecordingError(message) from None

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Settings of the run."""
        return self._table("settings")

    @cached_property
    def run(self) -> RecordedSettings:
        """Settings that sequences depend on."""
        try:
            return read_settings(self.settings)
        except RecordingError as error:
            error.args = (f"the settings in {self.path} do not say how it was made: {error}",)
            raise

    @cached_property
    def versions(self) -> dict[str, Any]:
        """Versions of the software that made it."""
        return self._table("versions")

    def steps(self) -> Generator[RecordedStep, None, None]:
        """Yield all steps that are complete, in order; RecordingError at a number that no run can
        have.
        """
        decoder = StepDecoder(len(self.profile.electrodes))
        for topic, message in self.messages():
            if topic != "/event":
                step = decoder.take(topic, message.sequence, message.data)
                if step is not None:
                    self._require_times(step, message.log_time - self.started_unix_ns)
                    yield step
        self.broken_steps = decoder.broken

    def _require_times(self, recorded: RecordedStep, at_ns: int) -> None:
        """Raise if a replay would wait too long for a step, which the file has at a time."""
        time_ns, period_us = recorded.step.input.time_ns, recorded.step.sequence.period_us
        if time_ns != at_ns or not 1 <= period_us <= LONGEST_PERIOD_US:
            raise RecordingError(
                f"{self.path} has an impossible step {at_ns / 1e9:.3f} s after its start: its time "
                f"is {time_ns / 1e9:.3f} s and its period {period_us} µs"
            )

    def events(self) -> Iterator[tuple[int, str]]:
        """Yield the time of each event, ns since the start of the run, and its text."""
        for topic, message in self.messages():
            if topic == "/event":
                try:
                    words = str(json.loads(message.data)["message"])
                except (ValueError, KeyError, TypeError):
                    continue
                yield message.log_time - self.started_unix_ns, words

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield all messages in JSON with their topics, in the order of the file."""
        for channel, message in self.all_messages():
            if channel.message_encoding == "json":
                yield channel.topic, message

    def _table(self, key: str) -> dict[str, Any]:
        try:
            table = json.loads(self.about[key])
        except (KeyError, ValueError):
            table = None
        if not isinstance(table, dict):
            raise RecordingError(f"the {key} in {self.path} cannot be read")
        return table
