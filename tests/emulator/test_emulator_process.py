"""The emulator as a process: its ports, its options, its account and its end."""

import json
import math
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
from smarttouch.sources.force import open_force
from smarttouch.sources.load_cell import open_cell

from ..boards.fresh import starter, until
from ..forks import EMULATOR, Forked

pytestmark = pytest.mark.usefixtures("patient_boards")

ZERO = b"\xff" + bytes(61)


@pytest.fixture
def start():
    """Return a starter of emulators: the process, a fork or its own, and the name of its port."""
    with starter() as begin:

        def run(*arguments, program=Forked):
            command = [*EMULATOR, *arguments, "--port-only"]
            command += [] if "--linger" in str(arguments) else ["--linger=2"]
            process = begin(command, program, stdin=subprocess.PIPE)
            assert select.select([process.stdout], [], [], 60)[0], "the emulator prints no port"
            return process, process.stdout.readline().strip()

        yield run


@pytest.fixture
def start_board(start, tmp_path):
    """Return a starter of boards that keep books in the test's folder."""
    return lambda *arguments, **how: start("board", f"--books={tmp_path}", *arguments, **how)


def connect(name):
    line = socket.create_connection(("127.0.0.1", int(name.rpartition(":")[2])), 5)
    line.settimeout(5)
    return line


def test_bytes_pass_as_they_are_before_a_host_sets_up_its_end(start_board):
    _, name = start_board("etactilekit", "--electrodes=8")
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
    _, name = start_board("kajimoto61", "--event=0 open 5", program=subprocess.Popen)
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
    process, name = start_board("etactilekit", "--electrodes=4", "--tcp", "--linger=0.6")
    assert name.startswith("tcp://127.0.0.1:")
    with connect(name) as host:
        host.sendall(bytes.fromhex("FC04 FD01 FA6400 F732 F4 FE 0000 6400 0000 0000"))
        assert host.recv(10) == b"\x04"
    assert process.wait(60) == 0
    assert read_state(tmp_path)["state"] == "driving"
    lasted_us = read_slots(tmp_path)["time_us"]
    assert lasted_us[-1] - lasted_us[0] > 400_000


def test_one_host_after_another_and_discovery(start_board):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        udp = free.getsockname()[1]
    _, name = start_board("etactilekit", "--tcp", f"--discovery-port={udp}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.settimeout(5)

        def ask():
            asking.sendto(b"ETK?", ("127.0.0.1", udp))
            return asking.recv(200).decode()

        port = name.rpartition(":")[2]
        wanted = f"ETK!;id=A1B2C3;name=emulator;ip=127.0.0.1;port={port};mode=STA;busy=%d;fw=1.0"
        assert ask() == wanted % 0
        for _ in range(2):
            with connect(name) as host:
                host.sendall(b"\xf5")
                assert host.recv(10) == b"\x04"
                assert ask() == wanted % 1
            until(lambda: ask() == wanted % 0)


@pytest.mark.parametrize(("linger", "program"), [("inf", subprocess.Popen), ("1e30", Forked)])
def test_ctrl_c_ends_a_board_without_a_host(start_board, tmp_path, linger, program):
    process, _ = start_board("kajimoto61", f"--linger={linger}", program=program)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    assert read_state(tmp_path)["reason"] == "signal"


@pytest.mark.parametrize(("arguments", "names"), [
    ("board link --electrodes=0", "0 1 4096"),
    ("board link --output=bent", "'bent' weighted"),
    ("board kajimoto61 --electrodes=60", "60 61"),
    ("board etactilekit --electrodes=256", "255 256"),
    ("board etactilekit --firmware=3", "'3' 71adee2"),
    ("board other", "emulator 'other' link"),
    ("board link --discovery-port=8888", "TCP"),
    ("board link --discovery-port=70000 --tcp", "70000 65535"),
    ("board link --linger=-1", "-1"),
    ("board link --linger=nan", "nan"),
    ("board link --compliance=0", "0"),
    ("board link --compliance=nan", "nan"),
    ("board link --books=/nowhere", "/nowhere"),
    ("board link --event=soon", "'soon'"),
    ("board link --electrodes=4 --event=1_open_4", "4 3"),
    ("sensor mouse", "emulator 'mouse' serial-array hx711 loadcell"),
    ("sensor loadcell --rate=0", "0 2000"),
    ("sensor serial-array --rows=256", "256 255"),
    ("sensor serial-array --columns=1", "1 255"),
    ("sensor serial-array --event=1_nan", "nan"),
    ("sensor serial-array --sensor=camera:0", "'camera 0' page FILE text STRING"),
    ("sensor hx711 --event=1_dance", "'1 dance' garbage"),
    ("sensor hx711 --noise=-1", "-1"),
    ("sensor hx711 --seed=-1", "-1"),
    ("sensor hx711 --force=nan", "nan"),
    ("sensor hx711 --counts-per-n=0", "0"),
    ("sensor hx711 --path=/nowhere.csv", "/nowhere.csv"),
    ("sensor hx711 --linger=-1", "-1"),
    ("sensor hx711 --profile=none", "'none'"),
    ("sensor hx711 --books=/nowhere/books", "/nowhere/books"),
])  # fmt: skip
def test_what_it_cannot_do_is_one_sentence(capsys, arguments, names):
    with pytest.raises(SystemExit) as ended:
        main([each.replace("_", " ") for each in arguments.split()])
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1].partition("error: ")[2]
    assert set(names.split()) <= set(re.split(r"[\s:,()]+", said))


def test_every_frame_of_an_array_is_read_dropped_or_lost(start, profile, tmp_path):
    books = tmp_path / "books.json"
    process, name = start(
        "sensor", "serial-array", "--rate=400", "--count=300", "--linger=0.2", f"--books={books}"
    )
    with open_source(f"serial-array:{name}", profile) as sensor:
        look = sensor.read(0)
        assert look.image.shape == (64, 64)
        read = {look.number}

        def see():
            look = sensor.read(0)
            read.add(look.number)
            return look

        until(lambda: see() and sensor._device._before >= 299)

        def is_over():
            """While the line is full none is sent: others come instead, after a while."""
            before = sensor.frames
            time.sleep(0.5)
            return see().stale and sensor.frames == before

        until(is_over)
    assert process.wait(60) == 0
    account = json.loads(books.read_text())
    assert account["sent"] == 300
    assert account["garbage"] == 0
    assert sensor.frames == len(read) + sensor.dropped_frames
    # What was sent while the port was opened, as many frames as that takes, was nobody's.
    assert 0 < sensor.frames <= 300


def test_a_cell_with_all_faults_and_orders(start, profile, changed):
    arguments = ("--force=0.6", "--counts-per-n=1000", "--event=0 unplug 0")
    process, name = start("sensor", "hx711", *arguments)
    in_newtons = changed(profile, {"force.curve": (-80.0, 0.001)})

    def order(words):
        process.stdin.write(f"{words}\n")
        process.stdin.flush()

    with open_force(f"hx711:{name}", in_newtons) as force:
        readings, watch = force._cell._readings, force._cell._watch
        for fault, seen in (
            ("garbage 0.6", lambda: readings.garbled > 0),
            ("nan 0.3", lambda: watch._empty > 0),
            ("unplug 0.4", lambda: watch._absence.times > 0),
        ):
            # One reading: the next may have come late, and be none.
            found = [math.nan]
            until(lambda found=found: found.append(force.read(0)) or found[-1] > 0)
            assert found[-1] == pytest.approx(0.6, abs=0.4)
            order(fault)
            until(lambda seen=seen: math.isnan(force.read(0)) and seen())
        until(lambda: force.read(0) > 0)
        assert watch._absence.times == 1
        assert len(force.notes) >= 3
    with open_cell(f"hx711:{name}") as cell:
        order("weight 200")
        until(lambda: cell.reading() > 81_600)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
    assert json.loads(process.stdout.read())["sent"] > 0


PARENT = """
import os, subprocess, sys
process = subprocess.Popen(
    [sys.executable, *sys.argv[1:], f"--parent={os.getpid()}"], start_new_session=True
)
process.wait()
"""


@pytest.mark.parametrize(("name", "hosted"), [("board", False), ("board", True), ("sensor", False)])
def test_it_ends_with_a_parent_that_is_killed(tmp_path, name, hosted):
    """Its end of a pipe that it has inherited closes: there is no trace of it left."""
    what, books = ("kajimoto61", tmp_path) if name == "board" else ("hx711", tmp_path / "sent")
    command = ["-m", "smarttouch.emulator", name, what, "--port-only", f"--books={books}"]
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, *command], stdout=subprocess.PIPE, text=True
    )
    try:
        port = parent.stdout.readline().strip()
        assert port.startswith("/dev/")
        if hosted:
            host = os.open(port, os.O_RDWR | os.O_NOCTTY)
        parent.kill()
        parent.wait()
        assert parent.stdout.read() == ""
        if name == "board":
            state = read_state(books)
            assert (state["state"], state["reason"]) == ("shorted", "parent gone")
        else:
            assert json.loads(books.read_text()) == {"sent": 0, "dropped": 0, "garbage": 0}
        if hosted:
            os.close(host)
    finally:
        parent.kill()
        parent.communicate()
