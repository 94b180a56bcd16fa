"""Reader of MCAP files of any program, also of those that were cut or damaged.

Records are decompressed and parsed within the limits of a recording."""

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from smarttouch.base.errors import RecordingError
from smarttouch.base.files import open_file, parse_json, unreadable

MOST_BYTES = 2**40  # largest recording: a month
MOST_CHUNK_BYTES = 128 * 2**20
"""Largest chunk and message. Ours have 1 MB and perhaps an image, of 80 megapixels."""
BASE_BYTES, MOST_INFLATION = 2 * MOST_CHUNK_BYTES, 200
"""Limits of all chunks together, decompressed: bytes, and ratio to the file. Ours have 2 to 6."""
BASE_MESSAGES = 100_000  # messages allowed in any recording, in addition to one for each byte of it
_MOST_VALUES = 2_000_000  # largest number of values in one message; each takes some 60 bytes
_LARGE_BYTES = 2**20
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


def chunk_records(data: bytes) -> Iterator[Record]:
    """Yield the records of a chunk; ValueError if it is damaged, or holds more than it declares."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(data)))
        content = _inflated(chunk)
    except Exception:
        # Decompressors and parsers of damaged bytes fail in every way there is.
        raise ValueError("a chunk is damaged") from None
    if len(content) != chunk.uncompressed_size:
        raise ValueError(f"a chunk has {len(content)} bytes, not {chunk.uncompressed_size}")
    if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
        raise ValueError("a chunk's checksum does not hold")
    for opcode, at, length in records_in(BytesIO(content)):
        if opcode in _READ and opcode != Opcode.METADATA:
            yield read_record(opcode, content[at : at + length])


def read_record(opcode: int, data: bytes) -> Record:
    """Return a record of one of the kinds in `_READ`; ValueError if it is invalid."""
    try:
        return _READ[opcode](ReadDataStream(BytesIO(data)), len(data))
    except Exception:
        raise ValueError("a record is damaged") from None


def parse_message(data: str | bytes) -> Any:
    """Return the value of a message in JSON; ValueError if it is invalid or too large."""
    if len(data) > _LARGE_BYTES:
        text = data if isinstance(data, bytes) else data.encode()
        values = sum(map(text.count, (b",", b"[", b"{")))
        if values > _MOST_VALUES:
            raise ValueError(f"a message of {values:,} values")
    return parse_json(data)


def _inflated(chunk: Chunk) -> bytes:
    most = chunk.uncompressed_size + 1
    if most > MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk claims {chunk.uncompressed_size:,} bytes")
    if chunk.compression == "zstd":
        inflater = zstandard.ZstdDecompressor(max_window_size=MOST_CHUNK_BYTES)
        return inflater.stream_reader(chunk.data).read(most)
    if chunk.compression == "lz4":
        data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, most)
        return data
    if chunk.compression:
        raise ValueError(f"compression {chunk.compression!r} is unknown")
    return chunk.data


_CHUNK = struct.Struct("<QQQ")  # head of a chunk: first time, last time, decompressed bytes
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
        self.ended: bool = False  # whether its end is there
        self.claims: list[int] = []  # bytes that each chunk claims to hold, decompressed
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
        try:
            for record in records:
                if not isinstance(record, Message):
                    self._note(record)
                elif (channel := self.channels.get(record.channel_id)) is not None:
                    yield channel, record
        except ValueError:
            self._bad_at.add(at)

    def _note(self, record: Record) -> None:
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
        for opcode, at, length in records_in(file, len(MCAP0_MAGIC)):
            file.seek(at)
            if opcode == Opcode.CHUNK and length >= _CHUNK.size:
                _, last_ns, claimed = _CHUNK.unpack(file.read(_CHUNK.size))
                self._last_ns = max(self._last_ns, last_ns)
                self.claims.append(claimed)
            elif opcode == Opcode.FOOTER:
                file.seek(at + length)
                self.ended = file.read() == MCAP0_MAGIC
            elif opcode in _READ and opcode != Opcode.MESSAGE and length <= _LONGEST_ABOUT:
                try:
                    self._note(read_record(opcode, file.read(length)))
                except ValueError:
                    self._bad_at.add(at)
