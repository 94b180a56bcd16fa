"""Reader of MCAP files of any program, also of those that were cut or damaged."""

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from smarttouch.base.errors import RecordingError
from smarttouch.base.files import open_file, unreadable
from smarttouch.running.mcap_chunks import (
    MOST_BYTES,
    MOST_CHUNK_BYTES,
    chunk_records,
    read_record,
    records_in,
)

_CHUNK = struct.Struct("<QQQ")
"""Head of a chunk: first time, last time, decompressed bytes."""
_LONGEST_ABOUT = 4 * 2**20


class McapFile:
    """An MCAP file: schemas, channels and metadata, and its messages as often as they are read.

    The reader of mcap needs the index at the end, which a killed program did not write. This one
    goes record by record, checks each chunk's CRC, and leaves out what is damaged. Raises
    RecordingError if there is no such file, or it is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.ended: bool = False
        """Whether its end is there."""
        self.claims: list[int] = []
        """Bytes that each chunk claims to hold, decompressed."""
        self._bad_at: set[int] = set()
        self._last_ns = 0
        try:
            with open_file(path, RecordingError, MOST_BYTES) as file:
                self._look_through(file)
        except OSError as error:
            raise unreadable(RecordingError, path, error) from None

    @property
    def damaged_chunks(self) -> int:
        """Number of damaged chunks so far."""
        return len(self._bad_at)

    def all_messages(self) -> Iterator[tuple[Channel, Message]]:
        """Yield all messages with their channels, in the order of the file."""
        try:
            with open_file(self.path, RecordingError, MOST_BYTES) as file:
                for opcode, at, length in records_in(file, len(MCAP0_MAGIC)):
                    if opcode not in (Opcode.CHUNK, Opcode.MESSAGE):
                        continue
                    if length > MOST_CHUNK_BYTES:
                        self._bad_at.add(at)
                        continue
                    file.seek(at)
                    yield from self._messages_in(opcode, at, file.read(length))
        except OSError as error:
            raise unreadable(RecordingError, self.path, error) from None

    def _messages_in(self, opcode: int, at: int, data: bytes) -> Iterator[tuple[Channel, Message]]:
        records = (
            chunk_records(data) if opcode == Opcode.CHUNK else map(read_record, [opcode], [data])
        )
        while True:
            try:
                record = next(records, None)
            except ValueError:
                self._bad_at.add(at)
                return
            if record is None:
                return
            if isinstance(record, Message):
                channel = self.channels.get(record.channel_id)
                if channel is not None:
                    yield channel, record
            else:
                self._note(record)

    def _note(self, record: object) -> None:
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Metadata):
            self.metadata[record.name] = record.metadata

    def _look_through(self, file: BinaryIO) -> None:
        """Read everything but the messages."""
        if not file.seek(0, os.SEEK_END):
            raise RecordingError(f"{self.path} is empty", about="file")
        file.seek(0)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{self.path} is no MCAP file", about="file")
        kinds: dict[int, Any] = {
            Opcode.METADATA: Metadata,
            Opcode.SCHEMA: Schema,
            Opcode.CHANNEL: Channel,
        }
        for opcode, at, length in records_in(file, len(MCAP0_MAGIC)):
            file.seek(at)
            if opcode == Opcode.CHUNK and length >= _CHUNK.size:
                _, last_ns, claimed = _CHUNK.unpack(file.read(_CHUNK.size))
                self._last_ns = max(self._last_ns, last_ns)
                self.claims.append(claimed)
            elif opcode == Opcode.FOOTER:
                file.seek(at + length)
                self.ended = file.read() == MCAP0_MAGIC
            elif opcode in kinds and length <= _LONGEST_ABOUT:
                try:
                    record = kinds[opcode].read(ReadDataStream(BytesIO(file.read(length))))
                except Exception:
                    self._bad_at.add(at)
                    continue
                self._note(record)
