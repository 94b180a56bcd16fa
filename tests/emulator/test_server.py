"""Emulated sensors, and the server of emulated devices: deadlines, full lines and orders."""

import numpy as np
import pytest

from smarttouch.emulator.firmware import Firmware
from smarttouch.emulator.sensors import EmulatedLoadCell, SensorArray, SensorFirmware
from smarttouch.emulator.server import Server
from smarttouch.sources.sensor_protocol import ArrayFrame, CellReading, MessageStream, TextReadings

MS = 10**6


class FakeLine:
    """Takes so many bytes at a time."""

    def __init__(self, room=10**9):
        self.room, self.taken = room, b""

    def write(self, data):
        taken, rest = data[: self.room], data[self.room :]
        self.taken += taken
        self.room -= len(taken)
        return rest


class FakeOrders:
    def __init__(self, *lines):
        self.lines = list(lines)

    def read(self):
        return [self.lines.pop(0)] if self.lines else []


class Counter(SensorFirmware):
    """A device that sends its numbers, four bytes each, 100 times a second."""

    def packet(self, number, time_s):
        return b"%03d;" % number


class Answering(Firmware):
    """A board that answers what it receives, and notes what happens to it."""

    def __init__(self):
        self.heard, self.calls = b"", []

    def feed(self, data, now_ns):
        self.heard += data
        return data

    def advance(self, now_ns):
        self.calls.append(now_ns // MS)
        return b""

    def hang_up(self, now_ns):
        self.calls.append("hung up")


def steps(line, *acts, device=None):
    """Let a server do what is due at times, ms, or without a host at a time, and give a line room.

    Acts are a time, a time without a host (in a list), or room as ``{"room": bytes}``.
    """
    server = Server(device or Counter(100.0), line)
    for act in acts:
        match act:
            case {"room": room}:
                line.room = room
            case [now_ms]:
                server.step(None, now_ms * MS)
            case now_ms:
                server.step(b"", now_ms * MS)
    return line.taken


@pytest.mark.parametrize(("room", "acts", "taken"), [
    # A packet at each deadline, and none without a host.
    (99, ([5], *range(100, 151)), b"000;001;002;003;004;005;"),
    # A late tick moves no deadline, and a long one is not made up for.
    (99, (0, 17, 20, 26, 30, *range(1000, 1010)), b"000;001;002;003;004;"),
    # What the host does not take is dropped and never queued.
    (6, (*range(50), {"room": 99}, *range(50, 61)), b"000;001;005;006;"),
    # A host that goes takes its half packet along.
    (2, (0, [1], {"room": 99}, 20), b"00001;"),
])  # fmt: skip
def test_what_a_sensor_sends(room, acts, taken):
    assert steps(FakeLine(room), *acts) == taken


def test_a_boards_answers_wait_for_a_host_that_reads_later_and_not_for_ever():
    board, line = Answering(), FakeLine(room=3)
    server = Server(board, line)
    server.step(b"abcd", 0)
    server.step(b"efgh", MS)
    line.room = 100
    server.step(b"", 2 * MS)
    assert line.taken == b"abcdefgh"
    line.room, board.backlog = 0, 8
    for now_ms, data in enumerate((b"ijkl", b"mnop", b"qrst"), 3):
        server.step(data, now_ms * MS)
    line.room = 100
    server.step(b"", 6 * MS)
    assert line.taken == b"abcdefghijklmnop"


def test_a_board_goes_on_without_a_host():
    board, line = Answering(), FakeLine()
    server = Server(board, line)
    for now_ms, data in enumerate((None, b"a", b"", None, None)):
        server.step(data, now_ms * MS)
    assert (board.heard, line.taken) == (b"a", b"a")
    assert board.calls == [0, 2, "hung up", 3, 4]


def test_orders(capsys):
    line = FakeLine()
    orders = FakeOrders("weight 100", "force x", "dance")
    server = Server(EmulatedLoadCell(0.0, noise=0), line, orders)
    for now_ms in range(4):
        server.step(b"", now_ms * MS)
    assert line.taken == b"HX711 reading: 129033\r\n"
    for order, said in zip(("force x", "dance"), capsys.readouterr().err.splitlines(), strict=True):
        assert repr(order) in said
        assert "weight GRAMS or force NEWTONS" in said


def test_an_array_sends_frames():
    device = SensorArray(4)
    stream, messages = MessageStream(), []
    for number in range(5):
        messages += stream.feed(device.packet(number, number / 4))
    frames = [each for each in messages if isinstance(each, ArrayFrame)]
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_us for frame in frames] == [0, 250_000, 500_000, 750_000, 1_000_000]
    assert frames[0].image.shape == (64, 64)
    # 40 pixels a second from right to left.
    np.testing.assert_array_equal(frames[0].image[:, 10:], frames[1].image[:, :-10])


@pytest.mark.parametrize("framed", [False, True])
def test_a_cell_follows_its_line(framed):
    device = EmulatedLoadCell(0.5, noise=0, framed=framed)

    def at(force_n):
        device.take_order(f"force {force_n}")
        data = device.packet(0, 0.0)
        if framed:
            (message,) = MessageStream().feed(data)
            assert isinstance(message, CellReading)
            return message.reading
        (reading,) = TextReadings().feed(b"\n" + data)
        return reading

    assert [at(0.5), at(1), at(-2)] == [105_000, 130_000, -20_000]
    assert at(1e9) == 2**23 - 1


def test_a_cells_noise():
    device = EmulatedLoadCell(-1.6, noise=50, framed=True)
    stream = MessageStream()
    readings = [stream.feed(device.packet(0, 0))[0].reading for _ in range(2000)]
    assert np.mean(readings) == pytest.approx(0, abs=5)
    assert np.std(readings) == pytest.approx(50, rel=0.1)
