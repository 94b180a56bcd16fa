"""Frames from a serial array: every one that came is counted, whatever else comes."""

import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SourceError, SourceLostError
from smarttouch.base.wire.device_lines import PtyLine
from smarttouch.sources import open_source, serial_array
from smarttouch.sources.sensor_protocol import encode_frame
from smarttouch.sources.serial_array import SerialArrayDevice

from ..support.checks import numbers_in, raises
from ..support.runs import until


class Line(PtyLine):
    """The device's end of a port.

    What is written comes when the system gets round to it: whoever reads waits for `sent` bytes.
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
    """Return a source that listens at the line."""
    source = SerialArrayDevice(line.name)
    source.open()
    assert source.grab(0) is None
    yield source
    source.close()


def frame(number, rows=4, columns=5):
    return encode_frame(number, 0, np.full((rows, columns), number % 256, np.uint8))


def grab_all(source, sent):
    """Return the shots in so many bytes since the source was opened, however late they come."""
    shots = []
    until(lambda: source._received >= sent or shots.append(source.grab(0)))
    return [shot for shot in shots if shot is not None]


def books(shots):
    return len(shots) + sum(shot.missed for shot in shots)


def test_of_many_at_once_the_newest_is_taken_and_all_are_counted(line, source):
    line.send(b"".join(frame(number) for number in range(20)))
    shots = grab_all(source, line.sent)
    assert books(shots) == source.frames == 20
    assert shots[-1].image[0, 0] == 19
    assert source.notes == []


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
    monkeypatch.setattr(serial_array, "_UNREADABLE_S", 0.0)
    assert source.grab(0) is None, "as long as nothing comes there is nothing to say"
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


def test_frames_over_tcp():
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
    assert books(shots) == 50
    assert shots[-1].image[0, 0] == 49


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
