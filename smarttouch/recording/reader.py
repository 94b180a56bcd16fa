"""Recordings read back: whole ones, and what is left of those that were cut or damaged."""

import json
import os
import struct
from collections.abc import Generator, Iterator
from datetime import UTC, datetime
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from pydantic import ValidationError

from smarttouch.errors import ProfileError, RecordingError
from smarttouch.imaging.mapping import Tone
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.recording.decoder import RecordedStep, StepDecoder
from smarttouch.recording.schemas import FORMAT, METADATA
from smarttouch.scan.frames import Sharing

_HEAD = struct.Struct("<BQ")
_TIMES = struct.Struct("<QQ")
_LONGEST_ABOUT = 4 * 2**20


class Recording:
    """A recording of a run.

    mcap's own reader wants an index at the end, which a killed program did not
    write. This one goes record by record, checks each chunk's CRC, and leaves
    out what does not hold.

    Parameters
    ----------
    path : Path
        The file.

    Attributes
    ----------
    about : dict of str to str
        What `about_run` told.
    schemas, channels : dict of int to Schema, Channel
        As far as they were met.
    broken_steps : int
        Steps, of the last time that all were read, that were incomplete.

    Raises
    ------
    RecordingError
        If there is no such file, or it is none of ours.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.about: dict[str, str] = {}
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.broken_steps = 0
        self._bad_at: set[int] = set()
        self._ended = False
        self._last_ns = 0
        try:
            with path.open("rb") as file:
                self._look_through(file)
        except OSError as error:
            raise RecordingError(f"cannot read {path}: {error.strerror}") from None
        found = self.about.get("format")
        if found is None:
            raise RecordingError(f"{path} tells nothing of a run: it is no recording of SmartTouch")
        if found != FORMAT:
            raise RecordingError(
                f"{path} is a recording of format {found!r}, this version reads {FORMAT}: use the "
                "version that made it"
            )

    @property
    def whole(self) -> bool:
        """Whether it was ended in order, and nothing that was read of it was damaged."""
        return self._ended and not self._bad_at and not self.broken_steps

    @property
    def damaged_chunks(self) -> int:
        """Chunks met so far that do not hold what was written."""
        return len(self._bad_at)

    @cached_property
    def started_unix_ns(self) -> int:
        """When the run began, ns since 1970."""
        try:
            return int(self.about["started_unix_ns"])
        except (KeyError, ValueError):
            raise RecordingError(f"{self.path} does not say when its run began") from None

    @property
    def started(self) -> datetime:
        """When the run began, UTC."""
        try:
            return datetime.fromtimestamp(self.started_unix_ns / 1e9, UTC)
        except (OverflowError, ValueError, OSError):
            raise RecordingError(
                f"{self.path} began at an impossible time, {self.started_unix_ns} ns"
            ) from None

    @property
    def duration_s(self) -> float:
        """Time from the start of the run to the last of what is kept, s."""
        return max(0, self._last_ns - self.started_unix_ns) / 1e9

    @cached_property
    def profile(self) -> Profile:
        """Device and finger of the run."""
        try:
            return Profile.model_validate_json(self.about.get("profile", ""))
        except (ValidationError, ProfileError) as error:
            first = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
            raise RecordingError(
                f"the profile in {self.path} is not one of this version's: {first}"
            ) from None

    @cached_property
    def settings(self) -> dict[str, Any]:
        """How the run was set up."""
        return self._table("settings")

    @property
    def tone(self) -> Tone | None:
        """How ink became activation; recordings from before there was a choice do not say."""
        told = self.settings.get("tone")
        return Tone(**told) if told else None

    @property
    def sharing(self) -> Sharing:
        """Classes whose points shared slots."""
        told = self.settings.get("sharing") or {"primaries": (), "planned": True}
        return Sharing(tuple(Primary[each] for each in told["primaries"]), told["planned"])

    @cached_property
    def versions(self) -> dict[str, Any]:
        """What made it."""
        return self._table("versions")

    def steps(self) -> Generator[RecordedStep, None, None]:
        """Yield all steps that are complete, in order."""
        decoder = StepDecoder()
        for topic, message in self.messages():
            if topic != "/event":
                step = decoder.take(topic, message.sequence, message.data)
                if step is not None:
                    yield step
        self.broken_steps = decoder.broken

    def events(self) -> Iterator[tuple[int, str]]:
        """Yield when what happened, ns since the start of the run, and in a few words."""
        for topic, message in self.messages():
            if topic == "/event":
                try:
                    words = str(json.loads(message.data)["message"])
                except (ValueError, KeyError, TypeError, RecursionError):
                    continue
                yield message.log_time - self.started_unix_ns, words

    def messages(self) -> Iterator[tuple[str, Message]]:
        """Yield all messages with their topics, in the order of the file."""
        try:
            with self.path.open("rb") as file:
                for opcode, at, length in _records(file):
                    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                        file.seek(at)
                        yield from self._messages_in(opcode, at, file.read(length))
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror}") from None

    def _messages_in(self, opcode: int, at: int, data: bytes) -> Iterator[tuple[str, Message]]:
        stream = ReadDataStream(BytesIO(data))
        try:
            records = (
                breakup_chunk(Chunk.read(stream), validate_crc=True)
                if opcode == Opcode.CHUNK
                else [Message.read(stream, len(data))]
            )
        except Exception:
            # Decompressors and parsers of damaged bytes fail in every way there is.
            self._bad_at.add(at)
            return
        for record in records:
            if isinstance(record, Message):
                channel = self.channels.get(record.channel_id)
                if channel is not None and channel.message_encoding == "json":
                    yield channel.topic, record
            else:
                self._note(record)

    def _note(self, record: object) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record

    def _look_through(self, file: BinaryIO) -> None:
        """Take in all but the messages."""
        if not file.seek(0, os.SEEK_END):
            raise RecordingError(f"{self.path} is empty")
        file.seek(0)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{self.path} is no MCAP file")
        kinds: dict[int, Any] = {
            Opcode.METADATA: Metadata,
            Opcode.SCHEMA: Schema,
            Opcode.CHANNEL: Channel,
        }
        for opcode, at, length in _records(file):
            file.seek(at)
            if opcode == Opcode.CHUNK and length >= _TIMES.size:
                self._last_ns = max(self._last_ns, _TIMES.unpack(file.read(_TIMES.size))[1])
            elif opcode == Opcode.FOOTER:
                file.seek(at + length)
                self._ended = file.read() == MCAP0_MAGIC
            elif opcode in kinds and length <= _LONGEST_ABOUT:
                try:
                    record = kinds[opcode].read(ReadDataStream(BytesIO(file.read(length))))
                except Exception:
                    self._bad_at.add(at)
                    continue
                self._note(record)
                if isinstance(record, Metadata) and record.name == METADATA:
                    self.about = record.metadata

    def _table(self, key: str) -> dict[str, Any]:
        try:
            table = json.loads(self.about[key])
        except (KeyError, ValueError):
            table = None
        if not isinstance(table, dict):
            raise RecordingError(f"the {key} in {self.path} cannot be read")
        return table


def _records(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and length of all records that are complete, to the footer."""
    size = file.seek(0, os.SEEK_END)
    at = len(MCAP0_MAGIC)
    while True:
        file.seek(at)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        opcode, length = _HEAD.unpack(head)
        at += _HEAD.size
        if length > size - at:
            return
        yield opcode, at, length
        if opcode == Opcode.FOOTER:
            return
        at += length
