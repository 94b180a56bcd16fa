"""The process of an emulated sensor: its arguments, its account, and its end."""

import json
import math
import select
import signal
import subprocess
import sys
import time

import pytest

from smarttouch.emulator.__main__ import main
from smarttouch.sources import open_sensor
from smarttouch.sources.forces.force import open_force
from smarttouch.sources.forces.load_cell import open_cell


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (["loadcell", "--rate=0"], ["--rate 0", "2000"]),
        (["serial-array", "--rows=256"], ["--rows 256", "255"]),
        (["serial-array", "--event=1 nan"], ["nan"]),
        (["serial-array", "--sensor=camera:0"], ["--sensor 'camera:0'", "page:", "text:"]),
        (["hx711", "--event=1 dance"], ["'1 dance'", "garbage"]),
        (["hx711", "--noise=-1"], ["--noise -1"]),
        (["hx711", "--force=nan"], ["--force nan"]),
        (["hx711", "--path=/nowhere.csv"], ["/nowhere.csv"]),
        (["hx711", "--linger=-1"], ["--linger -1"]),
        (["hx711", "--profile=none"], ["'none'"]),
        (["hx711", "--books=/nowhere/books"], ["/nowhere/books"]),
    ],
)
def test_wrong_arguments(capsys, arguments, names):
    with pytest.raises(SystemExit) as ended:
        main(["sensor", *arguments])
    assert ended.value.code == 2
    # Before it stands how it is called.
    _, error = capsys.readouterr().err.split("error: ")
    for name in names:
        assert name in error


@pytest.fixture
def start(tmp_path):
    """Return a starter of emulators: the process and the name of its port."""
    started = []

    def run(*arguments):
        command = [sys.executable, "-m", "smarttouch.emulator", "sensor"]
        command += ["--port-only", "--linger=2", *arguments]
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert select.select([process.stdout], [], [], 30)[0], "the emulator prints no port"
        return process, process.stdout.readline().strip()

    yield run
    for process in started:
        process.kill()
        process.communicate()


def until(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.01)


def test_every_frame_of_an_array_is_read_dropped_or_lost(start, profile, tmp_path):
    books = tmp_path / "books.json"
    process, name = start(
        "serial-array", "--rate=400", "--count=300", "--linger=0.2", f"--books={books}"
    )
    with open_sensor(f"serial-array:{name}", profile) as sensor:
        look = sensor.read(0)
        assert look.image.shape == (64, 64)
        read = {look.number}

        def see():
            look = sensor.read(0)
            read.add(look.number)
            return look

        until(lambda: see() and sensor._source._before >= 299)
        until(lambda: see().stale)
    assert process.wait(60) == 0
    account = json.loads(books.read_text())
    assert account["sent"] == 300
    assert account["garbage"] == 0
    assert sensor.frames == len(read) + sensor.dropped_frames
    # What was sent while the port was opened, as many frames as that takes, was nobody's.
    assert 0 < sensor.frames <= 300


@pytest.mark.realtime
def test_a_cell_with_all_faults_and_orders(start, profile, changed):
    events = ["0.4 garbage 0.6", "1.2 nan 0.3", "1.8 unplug 0.4"]
    process, name = start(
        "hx711", "--force=0.6", "--counts-per-n=1000", *(f"--event={each}" for each in events)
    )
    in_newtons = changed(profile, {"force.curve": (-80.0, 0.001)})
    with open_force(f"hx711:{name}", in_newtons) as force:
        for _ in events:
            until(lambda: force.read(0) > 0)
            assert force.read(0) == pytest.approx(0.6, abs=0.4)
            until(lambda: math.isnan(force.read(0)))
        until(lambda: force.read(0) > 0)
        assert force._cell._readings.garbled > 0
        assert force._cell._watch._none > 0
        assert force._cell._watch._absence.times == 1
        assert len(force.notes) >= len(events)
    with open_cell(f"hx711:{name}") as cell:
        process.stdin.write("weight 200\n")
        process.stdin.flush()
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


def test_it_ends_with_a_parent_that_is_killed(tmp_path):
    """Its end of a pipe that it has inherited closes: there is no trace of it left."""
    books = tmp_path / "books.json"
    command = ["-m", "smarttouch.emulator", "sensor", "hx711", "--port-only", f"--books={books}"]
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, *command], stdout=subprocess.PIPE, text=True
    )
    try:
        assert parent.stdout.readline().startswith("/dev/")
        parent.kill()
        parent.wait()
        assert parent.stdout.read() == ""
        assert json.loads(books.read_text()) == {"sent": 0, "dropped": 0, "garbage": 0}
    finally:
        parent.kill()
        parent.communicate()
