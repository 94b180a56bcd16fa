"""Reader of recordings, also of those that were cut or damaged."""

import math
from collections.abc import Generator, Iterator
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.records import Message
from pydantic import ValidationError

from smarttouch.base.errors import ProfileError, RecordingError
from smarttouch.profile import Profile
from smarttouch.running.mcap_file import (
    BASE_BYTES,
    BASE_MESSAGES,
    MOST_CHUNK_BYTES,
    MOST_INFLATION,
    McapFile,
    parse_message,
)
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
        self._require_size()
        found = self.about.get("format")
        if found is None:
            message = f"{path} has nothing of a run: it is no recording of SmartTouch"
            raise RecordingError(message, about="file")
        if found != FORMAT:
            raise RecordingError(
                f"{path} is a recording of format {found!r}, this version reads {FORMAT}: use the "
                "version that made it",
                about="format",
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
            raise RecordingError(message, about="started_unix_ns") from None

    @property
    def started(self) -> datetime:
        """Start of the run, UTC."""
        try:
            return datetime.fromtimestamp(self.started_unix_ns / 1e9, UTC)
        except (OverflowError, ValueError, OSError):
            raise RecordingError(
                f"{self.path} began at an impossible time, {self.started_unix_ns} ns",
                about="started_unix_ns",
            ) from None

    @property
    def duration_s(self) -> float:
        """Time from the start of the run to the last message, s."""
        return max(0, self._last_ns - self.started_unix_ns) / 1e9

    @cached_property
    def profile(self) -> Profile:
        """Device and finger of the run."""
        try:
            return Profile.model_validate_json(self.about.get("profile", ""))
        except (ValidationError, ProfileError) as error:
            first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
            message = f"the profile in {self.path} is not one of this version's: {first}"
            raise RecordingError(message, about="profile") from None

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
                    self._require_possible(step, message.log_time - self.started_unix_ns)
                    yield step
        self.broken_steps = decoder.broken

    def _require_possible(self, recorded: RecordedStep, at_ns: int) -> None:
        """Raise if the numbers of a step, which is filed at a time of the run, are impossible."""
        step, sequence = recorded.step, recorded.step.sequence
        for name, value, least, most in (
            ("time_ns", step.input.time_ns, at_ns, at_ns),
            ("age_ns", step.input.age_ns, 0, math.inf),
            ("period_us", sequence.period_us, 1, LONGEST_PERIOD_US),
            ("asked_us", step.asked_us, 0, LONGEST_PERIOD_US),
            ("recharge_us", sequence.recharge_us, 0, sequence.period_us),
            ("level", step.level, 0, 1),
            ("intensity", sequence.intensity, 0, 1),
        ):
            # No comparison holds of NaN.
            if not least <= value <= most:
                raise RecordingError(
                    f"{self.path} has a step {at_ns / 1e9:.3f} s after its start whose {name} is "
                    f"{str(value)[:24]}, which no run has: it was not made by recording",
                    about=name,
                )

    def events(self) -> Iterator[tuple[int, str]]:
        """Yield the time of each event, ns since the start of the run, and its text."""
        for topic, message in self.messages():
            if topic == "/event":
                try:
                    words = str(parse_message(message.data)["message"])
                except (ValueError, KeyError, TypeError):
                    continue
                yield message.log_time - self.started_unix_ns, words

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield all messages in JSON with their topics, in the order of the file."""
        for count, (channel, message) in enumerate(self.all_messages(), 1):
            if count > self._most_messages:
                raise RecordingError(
                    f"{self.path} holds more than {self._most_messages:,} messages, too many for "
                    "its size: it was not made by recording",
                    about="messages",
                )
            if channel.message_encoding == "json":
                yield channel.topic, message

    def _require_size(self) -> None:
        """Raise if the chunks declare more than a recording can hold."""
        size, claims = self.path.stat().st_size, self.claims
        believed = [each for each in claims if each <= MOST_CHUNK_BYTES]
        most = BASE_BYTES + MOST_INFLATION * size
        if sum(believed) > most or (claims and not believed):
            raise RecordingError(
                f"{self.path} of {size / 1e6:,.1f} MB claims to hold {sum(claims) / 1e6:,.0f} MB: "
                "it was not made by recording",
                about="chunks",
            )
        self._most_messages = BASE_MESSAGES + size

    def _table(self, key: str) -> dict[str, Any]:
        try:
            table = parse_message(self.about[key])
        except (KeyError, ValueError):
            table = None
        if not isinstance(table, dict):
            raise RecordingError(f"the {key} in {self.path} cannot be read", about=key)
        return table
