"""The wire format of sensors: what is encoded comes back, and no bytes do harm."""

import zlib

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from smarttouch.base.errors import SourceError
from smarttouch.base.wire.framing import Deframer, WirePacket, frame_packet
from smarttouch.sources.sensor_protocol import (
    LARGEST_BODY,
    NO_READING,
    VERSION,
    ArrayFrame,
    CellReading,
    MessageStream,
    PacketKind,
    decode,
    encode_force,
    encode_frame,
    gap,
)

from ..support.checks import raises

NUMBER = st.integers(0, 2**32 - 1)
SIDE = st.integers(1, 255)
IMAGE = st.tuples(SIDE, SIDE).filter(lambda shape: shape[0] * shape[1] < 2000)


def parse(data):
    (packet,) = Deframer(LARGEST_BODY).feed(data)
    return decode(packet)


@given(NUMBER, NUMBER, IMAGE.flatmap(lambda shape: arrays(np.uint8, shape)))
def test_frames_come_back(number, time_us, image):
    frame = parse(encode_frame(number, time_us, image))
    assert isinstance(frame, ArrayFrame)
    assert (frame.number, frame.time_us) == (number, time_us)
    assert frame.image.dtype == np.uint8
    np.testing.assert_array_equal(frame.image, image)


@given(NUMBER, NUMBER, st.none() | st.integers(NO_READING + 1, 2**31 - 1))
def test_readings_come_back(number, time_us, reading):
    expected = CellReading(number, time_us, reading)
    assert parse(encode_force(number, time_us, reading)) == expected


def test_the_page_in_the_docstring_is_what_is_sent():
    image = np.array([[1, 2, 3], [4, 0, 6]], np.uint8)
    body = bytes([1, 0x41]) + (5).to_bytes(4, "little")
    body += bytes([2, 3]) + (1000).to_bytes(4, "little") + bytes([1, 2, 3, 4, 0, 6])
    body += zlib.crc32(body).to_bytes(4, "little")
    assert encode_frame(5, 1000, image) == cobs.encode(body) + b"\0"
    body = bytes([1, 0x42]) + (6).to_bytes(4, "little")
    body += (-3).to_bytes(4, "little", signed=True) + (2000).to_bytes(4, "little")
    body += zlib.crc32(body).to_bytes(4, "little")
    assert encode_force(6, 2000, -3) == cobs.encode(body) + b"\0"


@pytest.mark.parametrize(("image", "value"), [
    (np.zeros((0, 4), np.uint8), (0, 4)),
    (np.zeros((4, 0), np.uint8), (4, 0)),
    (np.zeros((256, 4), np.uint8), (256, 4)),
    (np.zeros((4, 256), np.uint8), (4, 256)),
    (np.zeros((4, 4, 3), np.uint8), ((4, 4, 3), "uint8")),
    (np.zeros((4, 4)), ((4, 4), "float64")),
])  # fmt: skip
def test_what_no_frame_can_hold(image, value):
    with raises(SourceError, names="frame", value=value):
        encode_frame(0, 0, image)


@pytest.mark.parametrize("reading", [2**31, NO_READING - 1])
def test_what_no_reading_can_hold(reading):
    with raises(SourceError, names="reading", value=reading):
        encode_force(0, 0, reading)


HEAD = bytes([2, 3, 0, 0, 0, 0])


@pytest.mark.parametrize(("kind", "payload"), [
    (PacketKind.FRAME, b""), (PacketKind.FRAME, HEAD[:5]), (PacketKind.FRAME, HEAD + bytes(5)),
    (PacketKind.FRAME, HEAD + bytes(7)), (PacketKind.FRAME, bytes([0, 3, 0, 0, 0, 0])),
    (PacketKind.FRAME, bytes([3, 0, 0, 0, 0, 0])), (PacketKind.FORCE, bytes(7)),
    (PacketKind.FORCE, bytes(9)), (0x44, b""),
])  # fmt: skip
def test_malformed_payloads_give_nothing(kind, payload):
    assert decode(WirePacket(kind, 0, payload, VERSION)) is None


@given(st.sampled_from([*PacketKind, 0, 255]), st.binary(max_size=80))
def test_no_payload_crashes(kind, payload):
    message = decode(WirePacket(kind, 0, payload, VERSION))
    if isinstance(message, ArrayFrame):
        assert message.image.size == len(payload) - 6


def test_the_piece_one_joins_in_is_not_broken_but_later_ones_are():
    good = encode_force(1, 2, 3)
    stream = MessageStream()
    assert len(stream.feed(good[3:] + good)) == 1
    assert stream.broken == 0
    assert len(stream.feed(good[3:] + good)) == 1
    assert stream.broken == 1
    stream.feed(frame_packet(VERSION, 0x66, 0, b"of a later firmware"))
    assert stream.broken == 1
    stream.feed(frame_packet(VERSION, PacketKind.FORCE, 0, b"cut"))
    stream.feed(frame_packet(VERSION + 1, PacketKind.FORCE, 0, bytes(8)))
    assert stream.broken == 3


@pytest.mark.parametrize(("before", "number", "missing"), [
    (0, 1, 0), (0, 13, 12), (2**32 - 1, 0, 0), (2**32 - 2, 1, 2), (500, 0, 0), (7, 7, 0),
])  # fmt: skip
def test_gaps_in_numbers(before, number, missing):
    assert gap(before, number) == missing
