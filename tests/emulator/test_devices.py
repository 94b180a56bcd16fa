"""Tests of `Server` and of emulated devices: ports, options, delivery logs, and how they end."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from smarttouch.emulator.__main__ import main
from smarttouch.emulator.device_lines import TcpLine
from smarttouch.emulator.devices import EmulatedLoadCell, SensorArray, SensorFirmware, Server
from smarttouch.emulator.firmware_base import read_slots, read_state
from smarttouch.sources import open_source
from smarttouch.sources.force import open_force
from smarttouch.sources.serial_sensors import CellReading, MessageStream, TextReadings

from ..boards.emulator_waits import starter, until
from ..support.processes import Forked, emulator

MS = 10**6


@pytest.fixture
def start():
    """Return a function that starts an emulator, and returns its process and its port's name."""
    with starter() as begin:

        def run(device, *options, program=Forked):
            if not any(option.startswith("linger=") for option in options):
                options = ("linger=2", *options)
            process = begin(emulator(device, *options), program)
            assert select.select([process.stdout], [], [], 60)[0], "the emulator prints no port"
            return process, process.stdout.readline().strip()

        yield run


@pytest.fixture
def start_board(start, tmp_path):
    """Return a function that starts a board with its delivery log in the test's folder."""
    return lambda name, *options, **how: start(name, f"books={tmp_path}", *options, **how)


def connect(name):
    line = socket.create_connection(("127.0.0.1", int(name.rpartition(":")[2])), 5)
    line.settimeout(5)
    return line


def test_bytes_pass_as_they_are_before_a_host_sets_up_its_end(start_board):
    _, name = start_board("etactilekit", "electrodes=8")
    port = os.open(name, os.O_RDWR | os.O_NOCTTY)
    try:
        local = termios.tcgetattr(port)[3]
        assert not local & (termios.ICANON | termios.ECHO | termios.ISIG)
        # These bytes are control characters, which a terminal in its default mode would change.
        for count in (3, 4, 10, 13, 17, 19, 26, 127):
            os.write(port, bytes([0xFC, count, 0xF4]))
            assert select.select([port], [], [], 5)[0]
            assert os.read(port, 10) == bytes([count])
    finally:
        os.close(port)


def test_an_etactilekit_goes_on_without_its_host(start_board, tmp_path):
    process, name = start_board("etactilekit", "electrodes=4", "tcp", "linger=0.6")
    assert name.startswith("tcp://127.0.0.1:")
    for command in ("F5", "FC04 FD01 FA6400 F732 F4 FE 0000 6400 0000 0000"):
        with connect(name) as host:
            host.sendall(bytes.fromhex(command))
            assert len(host.recv(10)) == 1
    assert process.wait(60) == 0
    assert read_state(tmp_path)["state"] == "driving"
    lasted_us = read_slots(tmp_path)["time_us"]
    assert lasted_us[-1] - lasted_us[0] > 400_000


def test_a_host_that_reads_nothing_holds_no_device_up():
    with closing(TcpLine()) as line, connect(line.name) as host:
        until(lambda: line.read(1) is not None)
        ends = threading.Timer(10, host.close)
        ends.start()
        assert line.write(bytes(10**8))
        assert ends.is_alive()
        ends.cancel()


@pytest.mark.parametrize(("linger", "program"), [("inf", subprocess.Popen), ("1e30", Forked)])
def test_ctrl_c_ends_a_board_without_a_host(start_board, tmp_path, linger, program):
    process, _ = start_board("kajimoto61", f"linger={linger}", program=program)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    assert read_state(tmp_path)["reason"] == "signal"


@pytest.mark.parametrize(("url", "names"), [
    ("link?electrodes=0", "0 1 4096"),
    ("link?output=bent", "'bent' weighted"),
    ("link?ramp_ms=-1", "-1 10000"),
    ("kajimoto61?electrodes=60", "60 61"),
    ("etactilekit?electrodes=256", "255 256"),
    ("etactilekit?firmware=3", "'3' 71adee2"),
    ("other", "emulator 'other' link serial-array hx711 loadcell"),
    ("link?linger=nan", "nan"),
    ("link?books=/nowhere", "/nowhere"),
    ("link?event=soon", "'soon'"),
    ("link?electrodes=4&event=1 open 4", "4 3"),
    ("loadcell?rate=0", "0 2000"),
    ("hx711?force=nan", "nan"),
    ("hx711?linger=-1", "-1"),
    ("hx711?electrodes=4", "electrodes rate force"),
    ("", "emulator link"),
])  # fmt: skip
def test_what_it_cannot_do_is_one_sentence(capsys, monkeypatch, url, names):
    monkeypatch.setattr(sys, "argv", ["emulator", url])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1].partition("error: ")[2]
    assert set(names.split()) <= set(re.split(r"[\s:,()]+", said))


def test_every_frame_of_an_array_is_read_or_dropped(start, profile):
    process, name = start("serial-array", "rate=400", "linger=0.2")
    with open_source(f"serial-array:{name}", profile) as sensor:
        look = sensor.read(0)
        assert look.image.shape == (64, 64)
        read = {look.number}
        until(lambda: read.add(sensor.read(0).number) or sensor.frames > 100)
    assert sensor.frames == len(read) + sensor.dropped_frames
    assert process.wait(60) == 0


def test_a_cell_is_read_in_newtons(start, profile, changed):
    _, name = start("hx711", "force=0.6")
    in_newtons = changed(profile, {"force.curve": (-1.6, 1 / 50_000)})
    with open_force(f"hx711:{name}", in_newtons) as force:
        until(lambda: force.read(0) == pytest.approx(0.6, abs=0.01))


class FakeLine:
    """Line that accepts ``room`` more bytes, and returns the rest."""

    def __init__(self, room=10**9):
        self.room, self.taken = room, b""

    def write(self, data):
        taken, rest = data[: self.room], data[self.room :]
        self.taken += taken
        self.room -= len(taken)
        return rest


class Counter(SensorFirmware):
    """Sensor that sends the number of each packet as its content, in four bytes."""

    def packet(self, number, time_s):
        return b"%03d;" % number


@pytest.mark.parametrize(("room", "acts", "taken"), [
    # The server sends a packet at each deadline, but none without a host.
    (99, ([5], *range(100, 151)), b"000;001;002;003;004;005;"),
    # After a short delay, deadlines stay the same. Packets missed in a long delay are never sent.
    (99, (0, 17, 20, 26, 30, *range(1000, 1010)), b"000;001;002;003;004;"),
    # Packets that the host does not read are dropped, not queued.
    (6, (*range(50), {"room": 99}, *range(50, 61)), b"000;001;005;006;"),
    # If a host leaves during a packet, the next host does not get the rest of this packet.
    (2, (0, [1], {"room": 99}, 20), b"00001;"),
])  # fmt: skip
def test_what_a_sensor_sends(room, acts, taken):
    """An act is a time (ms), a list with a time without a host, or a new capacity of the line."""
    line = FakeLine(room)
    server = Server(Counter(100.0), line)
    for act in acts:
        match act:
            case {"room": more}:
                line.room = more
            case [now_ms]:
                server.step(None, now_ms * MS)
            case now_ms:
                server.step(b"", now_ms * MS)
    assert line.taken == taken


def test_an_array_moves_from_right_to_left():
    device, stream = SensorArray(4), MessageStream()
    frames = [stream.feed(device.packet(number, number / 4))[0] for number in range(5)]
    assert [frame.number for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.time_us for frame in frames] == [0, 250_000, 500_000, 750_000, 1_000_000]
    # Frames are 0.25 s apart, and the pattern moves by 40 pixels per second.
    np.testing.assert_array_equal(frames[0].image[:, 10:], frames[1].image[:, :-10])


@pytest.mark.parametrize("framed", [False, True])
@pytest.mark.parametrize(("force_n", "reading"), [(0.5, 105_000), (-2, -20_000), (1e9, 2**23 - 1)])
def test_a_cell_counts_its_force(framed, force_n, reading):
    device, readings = EmulatedLoadCell(force_n, framed=framed), []
    for number in range(100):
        data = device.packet(number, 0.0)
        if framed:
            (message,) = MessageStream().feed(data)
            assert isinstance(message, CellReading)
            readings.append(message.reading)
        else:
            readings += TextReadings().feed(b"\n" + data)
    assert np.mean(readings) == pytest.approx(reading, abs=30)
    assert np.std(readings) == pytest.approx(60 * (force_n < 1e9), rel=0.3)
