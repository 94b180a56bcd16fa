"""MCAP files of any program: what a chunk holds comes back, and a damaged one is left out."""

from io import BytesIO

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from smarttouch.base.errors import RecordingError
from smarttouch.running.mcap_file import McapFile

MESSAGES = [str(number).encode() * 50 for number in range(1000, 1030)]


@pytest.fixture(params=CompressionType, ids=lambda compression: compression.name)
def path(request, tmp_path):
    """A file of 30 messages, in chunks of ten."""
    with (tmp_path / "other.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=2200, compression=request.param)
        writer.start()
        writer.add_metadata("of the writer", {"key": "value"})
        channel = writer.register_channel("/topic", "text", 0)
        for at_ns, message in enumerate(MESSAGES):
            writer.add_message(channel, log_time=at_ns, data=message, publish_time=at_ns)
        writer.finish()
    return tmp_path / "other.mcap"


def read(path):
    """Return the contents of all messages, and the number of damaged chunks."""
    file = McapFile(path)
    return [message.data for _, message in file.all_messages()], file.damaged_chunks


def test_a_whole_file(path):
    file = McapFile(path)
    assert file.ended
    assert file.metadata == {"of the writer": {"key": "value"}}
    assert {channel.topic for channel, _ in file.all_messages()} == {"/topic"}
    assert read(path) == (MESSAGES, 0)


@pytest.mark.parametrize("chunk", [0, 1, 2])
def test_a_damaged_chunk_is_left_out(path, chunk):
    content = bytearray(path.read_bytes())
    index = make_reader(BytesIO(content)).get_summary().chunk_indexes[chunk]
    content[index.chunk_start_offset + int(0.8 * index.chunk_length)] ^= 1
    path.write_bytes(content)
    assert read(path) == (MESSAGES[: 10 * chunk] + MESSAGES[10 * chunk + 10 :], 1)


def test_a_cut_file_is_read_up_to_its_last_whole_chunk(path):
    content = path.read_bytes()
    index = make_reader(BytesIO(content)).get_summary().chunk_indexes[2]
    for end in (index.chunk_start_offset, index.chunk_start_offset + index.chunk_length - 1):
        path.write_bytes(content[:end])
        assert read(path) == (MESSAGES[:20], 0)
        assert not McapFile(path).ended


@pytest.mark.parametrize("content", [b"", b"precious"])
def test_what_is_no_mcap_file_is_one_sentence(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=str(path)):
        McapFile(path)
