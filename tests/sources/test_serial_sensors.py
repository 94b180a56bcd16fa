"""Tests of the sensors' wire format, and of the frames and counters of a serial array."""

import socket
import zlib

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.base.wire.framing import Deframer, WirePacket, frame_packet
from smarttouch.emulator.device_lines import PtyLine
from smarttouch.sources import open_source, serial_sensors
from smarttouch.sources.serial_sensors import (
    LARGEST_BODY,
    NO_READING,
    VERSION,
    ArrayFrame,
    CellReading,
    MessageStream,
    PacketKind,
    SerialArrayDevice,
    decode,
    encode_force,
    encode_frame,
    gap,
)

from ..support.checks import numbers_in, raises
from ..support.runs import until

NUMBER = st.integers(0, 2**32 - 1)
SIDE = st.integers(1, 255)
IMAGE = st.tuples(SIDE, SIDE).filter(lambda shape: shape[0] * shape[1] < 2000)


def parse(data):
    (packet,) = Deframer(LARGEST_BODY).feed(data)
    return decode(packet)


@given(
    NUMBER, NUMBER, IMAGE.flatmap(lambda shape: arrays(np.uint8, shape)),
    st.none() | st.integers(NO_READING + 1, 2**31 - 1),
)  # fmt: skip
def test_frames_and_readings_come_back(number, time_us, image, reading):
    frame = parse(encode_frame(number, time_us, image))
    assert isinstance(frame, ArrayFrame)
    assert (frame.number, frame.time_us, frame.image.dtype) == (number, time_us, np.uint8)
    np.testing.assert_array_equal(frame.image, image)
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
def test_what_no_packet_can_hold(image, value):
    with raises(SourceError, names="frame", value=value):
        encode_frame(0, 0, image)
    for reading in (2**31, NO_READING - 1):
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


class Line(PtyLine):
    """Device's end of a port.

    Bytes can arrive with a delay, so readers wait until they have received `sent` bytes.
    """

    sent = 0

    def send(self, data):
        self.sent += len(data)
        rest = [data]
        until(lambda: not rest.append(self.write(rest.pop())) and not rest[0])


@pytest.fixture
def line():
    line = Line()
    yield line
    line.close()


@pytest.fixture
def source(line):
    """Yield an open source, whose first `grab` has discarded earlier bytes."""
    source = SerialArrayDevice(line.name)
    source.open()
    assert source.grab(0) is None
    yield source
    source.close()


def frame(number, rows=4, columns=5):
    return encode_frame(number, 0, np.full((rows, columns), number % 256, np.uint8))


def grab_all(source, sent):
    """Grab until the source has received ``sent`` bytes in total; return the shots."""
    shots = []
    until(lambda: source._received >= sent or shots.append(source.grab(0)))
    return [shot for shot in shots if shot is not None]


def books(shots):
    return len(shots) + sum(shot.missed for shot in shots)


def test_what_came_before_anyone_listened_is_nobodys(line):
    source = SerialArrayDevice(line.name)
    source.open()
    line.send(frame(0) + frame(1)[:9])
    until(lambda: source._port.in_waiting >= line.sent)
    assert source.grab(0) is None
    line.send(frame(1)[9:] + frame(7))
    shot = source.grab(60)
    source.close()
    assert (shot.image[0, 0], source.frames, source.lost, source.garbled) == (7, 1, 0, 0)
    assert source.notes == []


def test_gaps_and_garbage_are_noted_once(line, source):
    broken = bytearray(frame(1))
    broken[-6] ^= 0x40
    for data in (frame(0), bytes(broken), frame(2), b"\1\2\3\0", frame(14)):
        line.send(data)
        grab_all(source, line.sent)
    assert (source.frames, source.lost, source.garbled) == (3, 12, 2)
    assert all(line.name in note for note in source.notes)
    counts = [numbers_in(note.replace(line.name, "")) for note in source.notes]
    assert counts == [[2], [12]]


def test_a_port_that_is_gone(line, source):
    line.send(frame(0))
    assert source.grab(60) is not None
    line.close()
    with raises(SourceLostError, value=source.title):
        source.grab(60)
    source.close()
    source.close()
    with raises(SourceError, value=line.name):
        source.open()


def test_bytes_that_are_no_frames_from_the_start_on(line, source, monkeypatch):
    monkeypatch.setattr(serial_sensors, "_UNREADABLE_S", 0.0)
    assert source.grab(0) is None, "a frame was read before any byte was sent"
    line.send(b"Reading: 12.3 g\r\n")
    odd = {"value": line.name}
    with raises(SourceError, **odd) as caught:
        grab_all(source, line.sent)
    assert "921600" in str(caught.value)


@given(st.lists(st.one_of(st.none(), st.binary(max_size=40)), max_size=20), st.integers(1, 60))
def test_every_frame_that_came_is_counted_whatever_is_between(pieces, size):
    source = SerialArrayDevice("nowhere")
    sent = 0
    data = b"\0"
    for piece in pieces:
        if piece is None:
            data += frame(sent)
            sent += 1
        else:
            data += piece.replace(b"\0", b"\1") + b"\0"
    shots = [source._take(data[at : at + size]) for at in range(0, len(data), size)]
    assert books([shot for shot in shots if shot is not None]) == sent == source.frames
    assert source.lost == 0


def test_of_many_over_tcp_the_newest_is_taken_and_all_are_counted():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        source = SerialArrayDevice(f"tcp://127.0.0.1:{port}")
        source.open()
        device, _ = listener.accept()
        with device:
            assert source.grab(0) is None
            data = b"".join(frame(number, 64, 64) for number in range(50))
            device.sendall(data)
            shots = grab_all(source, len(data))
        with raises(SourceLostError, value=source.title):
            source.grab(60)
        source.close()
    assert books(shots) == source.frames == 50
    assert shots[-1].image[0, 0] == 49
    assert source.notes == []


@pytest.mark.parametrize(("url", "baud", "about", "value"), [
    ("serial-array:", None, "port", None),
    ("serial-array:/dev/nowhere", None, "port", "/dev/nowhere"),
    ("serial-array:/dev/null", None, "port", "/dev/null"),
    ("serial-array:tcp://localhost", None, "port", "tcp://localhost"),
    ("serial-array:/dev/null", 0, "baud", 0),
])  # fmt: skip
def test_what_cannot_be_opened(profile, url, baud, about, value):
    with raises(SourceError, names=about, value=value):
        open_source(url, profile, baud=baud)
