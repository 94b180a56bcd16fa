"""Emulated sensors, and the server of emulated devices: deadlines, faults and orders."""

import math

import numpy as np
import pytest

from smarttouch.emulator.finger_events import parse
from smarttouch.emulator.firmware import Firmware
from smarttouch.emulator.sensors import EmulatedLoadCell, SensorArray, SensorFirmware
from smarttouch.emulator.server import FAULTS, Server
from smarttouch.sources.sensor_protocol import ArrayFrame, CellReading, MessageStream
from smarttouch.sources.serial_input import TextReadings

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
    """A device that sends its numbers, four bytes each."""

    def packet(self, number, time_s):
        return b"%03d;" % number


def parse_fault(text):
    return parse(text, FAULTS)


def make_server(device=None, line=None, faults=(), orders=()):
    line = line or FakeLine()
    wrong = [parse_fault(text) for text in faults]
    server = Server(device or Counter(100.0), line, wrong, FakeOrders(*orders))
    return server, line


def step(server, *times_ms, present=True):
    """Let a server do what is due, with or without a host."""
    for now_ms in times_ms:
        server.step(b"" if present else None, now_ms * MS)


def test_one_packet_at_each_deadline_and_none_without_a_host():
    server, line = make_server()
    step(server, 5, present=False)
    assert line.taken == b""
    step(server, *range(100, 151))
    assert line.taken == b"000;001;002;003;004;005;"
    assert (server.statistics.sent, server.statistics.dropped) == (6, 0)


def test_a_late_tick_moves_no_deadline_but_a_long_one_is_not_made_up_for():
    server, _ = make_server()
    step(server, 0, 17, 20, 26, 30)
    assert server.statistics.sent == 4
    step(server, *range(1000, 1010))
    assert server.statistics.sent == 5


def test_what_the_host_does_not_take_is_dropped_and_never_queued():
    server, line = make_server(line=FakeLine(room=6))
    step(server, *range(0, 50))
    assert line.taken == b"000;00"
    assert (server.statistics.sent, server.statistics.dropped) == (1, 3)
    line.room = 100
    step(server, *range(50, 61))
    assert line.taken == b"000;001;005;006;"
    assert (server.statistics.sent, server.statistics.dropped) == (4, 3)


def test_a_host_that_goes_takes_its_half_packet_along():
    server, line = make_server(line=FakeLine(room=2))
    step(server, 0)
    step(server, 1, present=False)
    line.room = 100
    step(server, 20)
    assert line.taken == b"00001;"
    assert server.statistics.sent == 1


def test_faults_of_the_line():
    server, line = make_server(faults=["0.0625 silent 0.0625"])
    taken = []
    for now_ms in range(0, 200):
        step(server, now_ms)
        taken.append(len(line.taken))
    assert taken[62] == taken[124] == 4 * 7 < taken[190]


def test_orders(capsys):
    cell = EmulatedLoadCell(0.0, noise=0)
    orders = ("weight 100", "force x", "silent 0.02", "dance")
    server, line = make_server(cell, orders=orders)
    step(server, *range(0, 60))
    assert line.taken == b"HX711 reading: 129033\r\n" * server.statistics.sent
    assert server.statistics.sent == 4
    number, dance = capsys.readouterr().err.splitlines()
    assert "'x'" in number
    assert "'0.003000 dance'" in dance
    assert "garbage, nan, freeze, silent" in dance


def test_garbage_is_nothing_and_ends_as_what_it_stands_for():
    array, cell = SensorArray(100.0), EmulatedLoadCell(1.0, framed=True, rate_hz=100.0)
    for device in (array, cell):
        server, line = make_server(device, faults=["0 garbage 0.05"])
        step(server, *range(0, 50))
        assert (server.statistics.sent, server.statistics.garbage) == (0, 5)
        stream = MessageStream()
        assert stream.feed(line.taken) == []
        assert stream.broken > 0
        line.taken = b""
        step(server, 50)
        assert [each.number for each in stream.feed(line.taken)] == [5]
    text, line = make_server(EmulatedLoadCell(1.0), faults=["0 garbage"])
    step(text, 0)
    assert line.taken.endswith(b"\r\n")
    assert TextReadings().feed(b"\n" + line.taken) == []


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


def test_a_boards_answers_wait_for_a_host_that_reads_later_and_not_for_ever():
    board = Answering()
    server, line = make_server(board, FakeLine(room=3))
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
    assert (server.statistics.sent, server.statistics.dropped) == (4, 1)


def test_a_board_goes_on_without_a_host_and_receives_nothing_on_a_silent_line():
    board = Answering()
    server, line = make_server(board, faults=["0.002 silent 0.002"])
    for now_ms, data in enumerate((None, b"a", b"", b"lost", None, None)):
        server.step(data, now_ms * MS)
    assert (board.heard, line.taken) == (b"a", b"a")
    assert board.calls == [0, 2, 3, "hung up", 4, 5]


def packet(device, number, time_s, *wrong):
    device.wrong = frozenset(wrong)
    return device.packet(number, time_s)


def test_an_array_sends_frames():
    device = SensorArray(4)
    stream, messages = MessageStream(), []
    for number in range(5):
        messages += stream.feed(packet(device, number, number / 4))
    frames = [each for each in messages if isinstance(each, ArrayFrame)]
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_us for frame in frames] == [0, 250_000, 500_000, 750_000, 1_000_000]
    assert frames[0].image.shape == (64, 64)
    # 40 pixels a second from right to left.
    np.testing.assert_array_equal(frames[0].image[:, 10:], frames[1].image[:, :-10])


def test_an_array_that_freezes():
    device = SensorArray(100)
    stream = MessageStream()
    (before,) = stream.feed(packet(device, 0, 0))
    (frozen,) = stream.feed(packet(device, 1, 10, "freeze"))
    (after,) = stream.feed(packet(device, 2, 10))
    np.testing.assert_array_equal(before.image, frozen.image)
    assert (after.image != frozen.image).any()


@pytest.mark.parametrize("framed", [False, True])
def test_a_cell_follows_its_line(framed):
    device = EmulatedLoadCell(0.5, noise=0, framed=framed)

    def at(force_n, *wrong):
        device.take_order(["force", str(force_n)])
        data = packet(device, 0, 0.0, *wrong)
        if framed:
            (message,) = MessageStream().feed(data)
            assert isinstance(message, CellReading)
            return message.reading
        (reading,) = TextReadings().feed(b"\n" + data)
        return None if math.isnan(reading) else reading

    assert [at(0.5), at(1), at(-2)] == [105_000, 130_000, -20_000]
    assert at(0.5, "freeze") == -20_000
    assert at(0.5, "nan") is None
    assert at(1e9) == 2**23 - 1


def test_a_cells_noise():
    device = EmulatedLoadCell(-1.6, noise=50, framed=True)
    stream = MessageStream()
    readings = [stream.feed(packet(device, 0, 0))[0].reading for _ in range(2000)]
    assert np.mean(readings) == pytest.approx(0, abs=5)
    assert np.std(readings) == pytest.approx(50, rel=0.1)
