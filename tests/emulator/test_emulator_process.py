"""The emulator as a process: its ports, its options, its account and its end."""

import os
import re
import select
import signal
import socket
import subprocess
import sys
import termios
import time

import pytest
import serial

from smarttouch.emulator.__main__ import main
from smarttouch.emulator.firmware import read_slots, read_state
from smarttouch.sources import open_source
from smarttouch.sources.force import open_cell, open_force

from ..boards.fresh import starter, until
from ..forks import Forked, emulator

pytestmark = pytest.mark.usefixtures("patient_boards")

ZERO = b"\xff" + bytes(61)


@pytest.fixture
def start():
    """Return a starter of emulators: the process, a fork or its own, and the name of its port."""
    with starter() as begin:

        def run(device, *options, program=Forked):
            if not any(option.startswith("linger=") for option in options):
                options = ("linger=2", *options)
            process = begin(emulator(device, *options), program, stdin=subprocess.PIPE)
            assert select.select([process.stdout], [], [], 60)[0], "the emulator prints no port"
            return process, process.stdout.readline().strip()

        yield run


@pytest.fixture
def start_board(start, tmp_path):
    """Return a starter of boards that keep books in the test's folder."""
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
        # Counts that a terminal in its usual mode would eat or change.
        for count in (3, 4, 10, 13, 17, 19, 26, 127):
            os.write(port, bytes([0xFC, count, 0xF4]))
            assert select.select([port], [], [], 5)[0]
            assert os.read(port, 10) == bytes([count])
    finally:
        os.close(port)


def test_a_kajimoto61_on_a_serial_port(start_board, tmp_path):
    _, name = start_board("kajimoto61", "event=0 open 5", program=subprocess.Popen)
    with serial.Serial(name, 921600, timeout=5) as port:
        port.write(ZERO)
        port.write(b"\xfe")
        reply = port.read(62)
    assert (len(reply), reply[-1], reply[5]) == (62, 0xFF, 71)
    # It outlives its host, as it was.
    time.sleep(0.2)
    with serial.Serial(name, 921600, timeout=5) as port:
        port.write(b"\xfe")
        assert len(port.read(62)) == 62
    until(lambda: read_state(tmp_path)["slots"] == 122)


def test_an_etactilekit_goes_on_without_its_host(start_board, tmp_path):
    process, name = start_board("etactilekit", "electrodes=4", "tcp", "linger=0.6")
    assert name.startswith("tcp://127.0.0.1:")
    with connect(name) as host:
        host.sendall(bytes.fromhex("FC04 FD01 FA6400 F732 F4 FE 0000 6400 0000 0000"))
        assert host.recv(10) == b"\x04"
    assert process.wait(60) == 0
    assert read_state(tmp_path)["state"] == "driving"
    lasted_us = read_slots(tmp_path)["time_us"]
    assert lasted_us[-1] - lasted_us[0] > 400_000


def test_one_host_after_another(start_board):
    _, name = start_board("etactilekit", "tcp")
    for _ in range(2):
        with connect(name) as host:
            host.sendall(b"\xf5")
            assert host.recv(10) == b"\x04"


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
    ("other", "emulator 'other' link"),
    ("link?linger=-1", "-1"),
    ("link?linger=nan", "nan"),
    ("link?books=/nowhere", "/nowhere"),
    ("link?event=soon", "'soon'"),
    ("link?electrodes=4&event=1 open 4", "4 3"),
    ("mouse", "emulator 'mouse' serial-array hx711 loadcell"),
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


def test_a_cell_with_orders(start, profile, changed):
    process, name = start("hx711", "force=0.6")
    in_newtons = changed(profile, {"force.curve": (-1.6, 1 / 50_000)})
    with open_force(f"hx711:{name}", in_newtons) as force:
        until(lambda: force.read(0) == pytest.approx(0.6, abs=0.01))
    with open_cell(f"hx711:{name}") as cell:
        process.stdin.write("weight 200\n")
        process.stdin.flush()
        until(lambda: cell.reading() > 170_000)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
