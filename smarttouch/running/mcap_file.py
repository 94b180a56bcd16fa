"""Reader of MCAP files of any program, also of those that were cut or damaged."""

import os
import struct
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from smarttouch.base.errors import RecordingError
from smarttouch.base.files import open_file, unreadable

MOST_BYTES = 2**40  # largest recording: a month
MOST_RECORD_BYTES = 128 * 2**20
"""Largest chunk and message. Ours have 1 MB and perhaps an image, of 80 megapixels."""
_HEAD = struct.Struct("<BQ")
_INVALID = 0  # opcode of no record: what follows is no part of a recording
Record = Schema | Channel | Message | Metadata
_READ: dict[int, Callable[[ReadDataStream, int], Record]] = {
    Opcode.SCHEMA: lambda stream, _: Schema.read(stream),
    Opcode.CHANNEL: lambda stream, _: Channel.read(stream),
    Opcode.METADATA: lambda stream, _: Metadata.read(stream),
    Opcode.MESSAGE: Message.read,
}


def records_in(file: BinaryIO, at: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and length of all records that are complete, to the footer."""
    size = file.seek(0, os.SEEK_END)
    while True:
        file.seek(at)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            return
        opcode, length = _HEAD.unpack(head)
        at += _HEAD.size
        if length > size - at or opcode == _INVALID:
            return
        yield opcode, at, length
        if opcode == Opcode.FOOTER:
            return
        at += length


def read_records(opcode: int, data: bytes) -> list[McapRecord]:
    """Return the records of a chunk, or the one record; ValueError if it is damaged."""
    stream = ReadDataStream(BytesIO(data))
    try:
        if opcode == Opcode.CHUNK:
            return breakup_chunk(Chunk.read(stream), validate_crc=True)
        return [_READ[opcode](stream, len(data))]
    except Exception:
        # Decompressors and parsers of damaged bytes fail in every way there is.
        raise ValueError("a record is damaged") from None


_CHUNK = struct.Struct("<QQ")  # head of a chunk: first time, last time


class McapFile:
    """An MCAP file: channels and metadata, and its messages as often as they are read.

    The reader of mcap needs the index at the end, which a killed program did not write. This one
    goes record by record, checks each chunk's CRC, and leaves out what is damaged. Raises
    RecordingError if there is no such file, or it is no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.ended: bool = False  # whether its end is there
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
                    if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                        for record in self._records(file, opcode, at, length):
                            if isinstance(record, Message) and record.channel_id in self.channels:
                                yield self.channels[record.channel_id], record
        except OSError as error:
            raise unreadable(RecordingError, self.path, error) from None

    def _records(self, file: BinaryIO, opcode: int, at: int, length: int) -> list[McapRecord]:
        """Return the records at a place, after noting channels and metadata."""
        try:
            if length > MOST_RECORD_BYTES:
                raise ValueError(f"a record has {length:,} bytes")
            file.seek(at)
            records = read_records(opcode, file.read(length))
        except ValueError:
            self._bad_at.add(at)
            return []
        for record in records:
            if isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Metadata):
                self.metadata[record.name] = record.metadata
        return records

    def _look_through(self, file: BinaryIO) -> None:
        """Read everything but the messages."""
        if not file.seek(0, os.SEEK_END):
            raise RecordingError(f"{self.path} is empty")
        file.seek(0)
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{self.path} is no MCAP file")
        for opcode, at, length in records_in(file, len(MCAP0_MAGIC)):
            if opcode == Opcode.CHUNK and length >= _CHUNK.size:
                file.seek(at)
                self._last_ns = max(self._last_ns, _CHUNK.unpack(file.read(_CHUNK.size))[1])
            elif opcode == Opcode.FOOTER:
                file.seek(at + length)
                self.ended = file.read() == MCAP0_MAGIC
            elif opcode in _READ and opcode != Opcode.MESSAGE:
                self._records(file, opcode, at, length)
