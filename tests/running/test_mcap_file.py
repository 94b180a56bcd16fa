"""No file of a recording takes more time or memory than a recording would."""

import contextlib
import json
import random
import re
import struct
import zlib

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode

from smarttouch.base.errors import RecordingError, SmartTouchError
from smarttouch.running.mcap_file import (
    BASE_BYTES,
    MOST_CHUNK_BYTES,
    chunk_records,
    parse_message,
    records_in,
)
from smarttouch.running.recording_files import describe, repair
from smarttouch.running.recording_reader import Recording

from ..raising import raises

MAGIC = b"\x89MCAP0\r\n"


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def message(data, channel=1):
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", channel, 0, 0, 0) + data)


def chunk(content, compression="zstd", claimed=None, checksum=None):
    """Return the body of a chunk record."""
    data = {
        "zstd": zstandard.ZstdCompressor(3).compress,
        "lz4": lz4.frame.compress,
        "": bytes,
        "rot13": bytes,
    }[compression](content)
    head = struct.pack(
        "<QQQII", 0, 0, len(content) if claimed is None else claimed,
        zlib.crc32(content) if checksum is None else checksum, len(compression),
    )  # fmt: skip
    return head + compression.encode() + struct.pack("<Q", len(data)) + data


def metadata(about):
    fields = b"".join(
        struct.pack("<I", len(each)) + each
        for key, value in about.items()
        for each in (key.encode(), value.encode())
    )
    name = struct.pack("<I", 10) + b"smarttouch"
    return record(Opcode.METADATA, name + struct.pack("<I", len(fields)) + fields)


@pytest.fixture
def write(tmp_path, about):
    def written(*records):
        path = tmp_path / "forged.mcap"
        path.write_bytes(MAGIC + metadata({"format": "1", **about}) + b"".join(records))
        return path

    return written


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
@pytest.mark.parametrize("checksum", [None, 0])
def test_what_was_written_comes_back(compression, checksum):
    content = message(b"one") + message(b"two")
    found = [each.data for each in chunk_records(chunk(content, compression, checksum=checksum))]
    assert found == [b"one", b"two"]


@pytest.mark.parametrize("compression", ["zstd", "lz4", ""])
@pytest.mark.parametrize(
    "wrong", [{"claimed": 3}, {"claimed": 10**6}, {"checksum": 7}, {"claimed": 2**63}]
)
def test_what_does_not_hold(compression, wrong):
    with pytest.raises(ValueError):
        list(chunk_records(chunk(message(b"one"), compression, **wrong)))


def test_an_unknown_compression():
    with pytest.raises(ValueError):
        list(chunk_records(chunk(message(b"one"), "rot13")))


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_no_more_is_unpacked_than_was_claimed(compression, traced_peak):
    bomb = chunk(bytes(200_000_000), compression, claimed=1000)
    assert len(bomb) < 1_000_000
    traced_peak.reset()
    with pytest.raises(ValueError):
        list(chunk_records(bomb))
    assert traced_peak() < 20_000_000


def test_a_bomb_of_many_chunks_is_refused_before_any_is_unpacked(write, monkeypatch):
    body = chunk(message(bytes(30_000_000)))
    path = write(*[record(Opcode.CHUNK, body)] * 40)
    assert path.stat().st_size < 133_000

    def unpack(*_, **__):
        raise AssertionError("unpacked")

    monkeypatch.setattr(zstandard, "ZstdDecompressor", unpack)
    for act in (Recording, describe, repair):
        with raises(RecordingError, about="chunks", value=1.2e9):
            act(path)


def test_a_chunk_beyond_belief(write):
    body = chunk(message(b"{}"), claimed=MOST_CHUNK_BYTES + 1)
    with raises(
        RecordingError, about="chunks", value=MOST_CHUNK_BYTES + 1, allowed=MOST_CHUNK_BYTES
    ):
        Recording(write(record(Opcode.CHUNK, body)))
    # Beside one that holds, it is a damage like any other.
    path = write(record(Opcode.CHUNK, body), record(Opcode.CHUNK, chunk(message(b"{}"))))
    recording = Recording(path)
    assert list(recording.messages()) == []
    assert recording.damaged_chunks == 1


def test_too_many_messages(write):
    schema = record(Opcode.CHANNEL, struct.pack("<HHI", 1, 0, 6) + b"/event" + struct.pack("<I", 4)
                    + b"json" + struct.pack("<I", 0))  # fmt: skip
    path = write(record(Opcode.CHUNK, chunk(schema + message(b"") * 300_000)))
    assert path.stat().st_size < 50_000
    with raises(RecordingError, about="messages") as caught:
        list(Recording(path).messages())
    most = re.search(r"more than ([\d,]+) messages", str(caught.value))[1]
    assert int(most.replace(",", "")) < 150_000


def test_what_a_recording_may_hold_is_more_than_any_holds(goldens):
    for path in goldens:
        recording = Recording(path)
        assert recording.damaged_chunks == 0
        inside = sum(len(each.data) for _, each in recording.messages())
        assert inside < 10 * path.stat().st_size < BASE_BYTES / 100


def test_a_message_of_too_many_values():
    assert parse_message(json.dumps([0] * 900_000)) == [0] * 900_000
    assert parse_message(json.dumps("," * 3_000)) == "," * 3_000
    with pytest.raises(ValueError, match="6,000,002"):
        parse_message(b"[" + b"[]," * 3_000_000 + b"[]]")
    with pytest.raises(ValueError):
        parse_message(b"[" * 100_000)


def test_zeros_without_end_are_no_records(write):
    path = write()
    with path.open("r+b") as file:
        file.truncate(2**39)
    with path.open("rb") as file:
        assert [opcode for opcode, _, _ in records_in(file, len(MAGIC))] == [Opcode.METADATA]
    assert list(Recording(path).steps()) == []


def test_no_random_records_are_anything_but_an_error(write):
    for seed in range(60):
        chance = random.Random(seed)
        records = [
            record(chance.randrange(16), chance.randbytes(chance.choice((0, 3, 30, 300))))
            for _ in range(9)
        ]
        path = write(*records)
        with contextlib.suppress(SmartTouchError):
            assert describe(path)[0][0] == "state"
