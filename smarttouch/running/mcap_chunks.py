"""Records of a recording's file, decompressed and parsed within the limits of a recording."""

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

from smarttouch.base.files import parse_json

MOST_BYTES = 2**40
"""Largest recording: a month."""
MOST_CHUNK_BYTES = 128 * 2**20
"""Largest chunk and message. Ours have 1 MB and perhaps an image, of 80 megapixels."""
BASE_BYTES, MOST_INFLATION = 2 * MOST_CHUNK_BYTES, 200
"""Limits of all chunks together, decompressed: bytes, and ratio to the file. Ours have 2 to 6."""
BASE_MESSAGES = 100_000
"""Messages allowed in any recording, in addition to one for each byte of it."""
_MOST_VALUES = 2_000_000
"""Largest number of values in one message; each takes some 60 bytes."""
_LARGE_BYTES = 2**20
_HEAD = struct.Struct("<BQ")
_INVALID = 0
"""Opcode of no record: what follows is no part of a recording."""


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


def chunk_records(data: bytes) -> Iterator[Schema | Channel | Message]:
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
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            yield read_record(opcode, content[at : at + length])


def read_record(opcode: int, data: bytes) -> Schema | Channel | Message:
    """Return a schema, a channel or a message; ValueError if it is invalid."""
    stream = ReadDataStream(BytesIO(data))
    record: Schema | Channel | Message
    try:
        if opcode == Opcode.SCHEMA:
            record = Schema.read(stream)
        elif opcode == Opcode.CHANNEL:
            record = Channel.read(stream)
        else:
            record = Message.read(stream, len(data))
    except Exception:
        raise ValueError("a record is damaged") from None
    return record


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
