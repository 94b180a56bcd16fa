"""The emulator as a process: its ports, its options and its end."""

import os
import select
import signal
import socket
import subprocess
import sys
import termios
import time

import pytest
import serial

from smarttouch.boards.emulator.__main__ import main
from smarttouch.boards.emulator.books import read_slots, read_state

ZERO = b"\xff" + bytes(61)


@pytest.fixture
def start(tmp_path):
    """Return a starter of emulators: the process and the name of its port."""
    started = []

    def run(*arguments):
        command = [sys.executable, "-m", "smarttouch.boards.emulator", f"--books={tmp_path}"]
        process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert select.select([process.stdout], [], [], 60)[0], "the emulator prints no port"
        return process, process.stdout.readline().strip()

    yield run
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def connect(name):
    line = socket.create_connection(("127.0.0.1", int(name.rpartition(":")[2])), 5)
    line.settimeout(5)
    return line


def wait_for(condition, timeout_s=10.0):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.02)


def test_bytes_pass_as_they_are_before_a_host_sets_up_its_end(start):
    _, name = start("--protocol=etactilekit", "--electrodes=8")
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


def test_a_kajimoto61_on_a_serial_port(start, tmp_path):
    _, name = start("--protocol=kajimoto61", "--event=0 open 5")
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
    wait_for(lambda: read_state(tmp_path)["slots"] == 122)


def test_an_etactilekit_goes_on_without_its_host(start, tmp_path):
    process, name = start("--protocol=etactilekit", "--electrodes=4", "--tcp", "--linger=0.6")
    assert name.startswith("tcp://127.0.0.1:")
    with connect(name) as host:
        host.sendall(bytes.fromhex("FC04 FD01 FA6400 F732 F4 FE 0000 6400 0000 0000"))
        assert host.recv(10) == b"\x04"
    assert process.wait(60) == 0
    assert read_state(tmp_path)["state"] == "driving"
    lasted_us = read_slots(tmp_path)["time_us"]
    assert lasted_us[-1] - lasted_us[0] > 400_000


def test_another_firmware_answers_otherwise(start):
    _, name = start("--protocol=etactilekit", "--tcp", "--firmware=936c6c0")
    with connect(name) as host:
        host.sendall(b"\xf4\xf5")
        assert host.recv(10) == b"\x04"


def test_one_host_after_another_and_discovery(start):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        udp = free.getsockname()[1]
    _, name = start("--protocol=etactilekit", "--tcp", f"--discovery-port={udp}")
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
            wait_for(lambda: ask() == wanted % 0)


def test_what_stays_for_ever_ends_on_ctrl_c(start, tmp_path):
    process, _ = start("--protocol=kajimoto61", "--linger=inf")
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    assert read_state(tmp_path)["reason"] == "signal"


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ("", "--electrodes"),
        ("--electrodes=0", "--electrodes"),
        ("--protocol=kajimoto61 --electrodes=60", "kajimoto61 61 60"),
        ("--protocol=etactilekit --electrodes=256", "255 256"),
        ("--protocol=other", "--protocol 'other'"),
        ("--electrodes=4 --discovery-port=8888", "--discovery-port --tcp"),
        ("--electrodes=4 --linger=-1", "--linger -1"),
        ("--electrodes=4 --linger=nan", "--linger nan"),
        ("--electrodes=4 --compliance=0", "--compliance 0"),
        ("--electrodes=4 --books=/nowhere", "/nowhere"),
        ("--electrodes=4 --event=soon", "'soon'"),
        ("--electrodes=4 --event=1_open_4", "4 3"),
    ],
)
def test_what_it_cannot_do_is_one_sentence(capsys, arguments, names):
    with pytest.raises(SystemExit) as ended:
        main([each.replace("_", " ") for each in arguments.split()])
    assert ended.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1].partition("error: ")[2]
    assert set(names.split()) <= set(said.replace(":", " ").replace(",", " ").split())


PARENT = """
import os, subprocess, sys
process = subprocess.Popen(
    [sys.executable, *sys.argv[1:], f"--parent={os.getpid()}"], start_new_session=True
)
process.wait()
"""


@pytest.mark.parametrize("hosted", [False, True])
def test_it_ends_with_a_parent_that_is_killed(tmp_path, hosted):
    """Its end of a pipe that it has inherited closes: there is no trace of it left."""
    command = [
        "-m", "smarttouch.boards.emulator", "--protocol=kajimoto61", "--linger=inf",
        f"--books={tmp_path}",
    ]  # fmt: skip
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, *command], stdout=subprocess.PIPE, text=True
    )
    try:
        name = parent.stdout.readline().strip()
        if hosted:
            host = os.open(name, os.O_RDWR | os.O_NOCTTY)
        parent.kill()
        parent.wait()
        assert parent.stdout.read() == ""
        state = read_state(tmp_path)
        assert (state["state"], state["reason"]) == ("shorted", "parent gone")
        if hosted:
            os.close(host)
    finally:
        parent.kill()
        parent.communicate()
