"""A stop reaches every program that has a board open, and all displays share one budget."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

import smarttouch as st
from smarttouch.boards import open_boards
from smarttouch.boards.emulator.delivery_log import read_state
from smarttouch.boards.link import LinkBoard
from smarttouch.boards.open_boards import OpenBoard, currents_ma, stop_all
from smarttouch.errors import BoardError, BoardStoppedError
from smarttouch.recording.reader import Recording
from tests.boards.fresh import until

from ..forks import Forked

pytestmark = pytest.mark.realtime
BEGUN = "begun"


@pytest.fixture(autouse=True)
def own_state(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    yield
    open_boards._stopped = False


@pytest.fixture
def start(tmp_path):
    """Return a starter of Python programs; each prints a line when pulses flow."""
    started = []

    def run(text, *arguments):
        path = tmp_path / f"program{len(started)}.py"
        path.write_text("import sys, time\nimport smarttouch as st\n" + textwrap.dedent(text))
        command = [sys.executable, str(path), *map(str, arguments)]
        process = Forked(command, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline().strip() == BEGUN
        return process

    yield run
    for process in started:
        process.kill()
        process.communicate()


RUN = """
    from smarttouch.sources.forces.force import open_force
    display = st.open_display("link:" + sys.argv[1], "electric-mouse")
    source = st.open_source("text:Hello", display.profile)
    begun = []

    def follow(result):
        if result.acknowledged > 20 and not begun:
            begun.append(print("begun", flush=True))

    listeners = [follow, st.Recorder(sys.argv[2])]
    try:
        pressing = open_force("fixed:0.5", display.profile)
        settings = dict(intensity=0.3, listeners=listeners, force=pressing)
        for _ in range(20):
            st.run(st.open_source("text:Hello", display.profile), display, **settings)
            settings["listeners"] = [follow]
    except st.SmartTouchError as error:
        print(type(error).__name__, flush=True)
        try:
            with display.board:
                print("went on", flush=True)
        except st.SmartTouchError as again:
            print(type(again).__name__, flush=True)
    finally:
        print("finally", flush=True)
"""
BARE = """
    import numpy as np
    display = st.open_display("link:" + sys.argv[1], "electric-mouse")
    board, time_ns = display.board, 0
    board.open()
    current = np.zeros((1, 64), np.int16)

    def send(level):
        global time_ns
        time_ns += 20_000_000
        current[0, :2] = 1000 * level, -1000 * level
        one = np.array([100], np.uint16)
        board.send(st.ScanSequence(current, one, one, one * 0, 20_000, level, time_ns))
        time.sleep(0.02)

    try:
        for step in range(10_000):
            send(min(0.2, 0.004 * step))
            if step == 10:
                print("begun", flush=True)
    except st.SmartTouchError as error:
        print(type(error).__name__, flush=True)
    try:
        board.close()
        board.open()
        print("went on", flush=True)
    except st.SmartTouchError as error:
        print(type(error).__name__, flush=True)
"""


def slots_of(folder):
    return read_state(folder)["slots"]


def settled(folder):
    """Return the number of slots once no more are delivered."""
    last = -1
    while (now := slots_of(folder)) != last:
        last = now
        time.sleep(0.15)
    return now


def is_whole(path):
    recording = Recording(path)
    return any(recording.steps()) and recording.whole


@pytest.fixture
def emulated(start_emulator, tmp_path):
    """A link board of 64 electrodes: its port, and its books."""
    books = tmp_path / "books"
    books.mkdir()
    _, port = start_emulator(f"--books={books}", electrodes=64)
    return port, books


@pytest.mark.parametrize("program", [RUN, BARE], ids=["run", "bare"])
def test_a_stop_ends_a_program_and_it_cannot_go_on(program, start, emulated, tmp_path):
    port, books = emulated
    process = start(program, port, tmp_path / "run.mcap")
    until(lambda: slots_of(books))
    assert stop_all() == 1
    flowed = settled(books)
    words = process.communicate(timeout=30)[0].split()
    assert words[:2] == ["BoardStoppedError"] * 2
    assert "on" not in words
    assert slots_of(books) == flowed > 0
    if program is RUN:
        assert is_whole(tmp_path / "run.mcap")


def test_sigterm_closes_the_recording_of_a_program(start, emulated, tmp_path):
    port, _ = emulated
    process = start(RUN, port, tmp_path / "run.mcap")
    process.send_signal(signal.SIGTERM)
    words = process.communicate(timeout=30)[0].split()
    assert process.returncode == 128 + signal.SIGTERM
    assert words == ["finally"]
    assert is_whole(tmp_path / "run.mcap")


def test_a_display_that_was_stopped_drives_nothing(emulated, make_sequence):
    port, books = emulated
    display = st.open_display(f"link:{port}", "electric-mouse")
    with display.board as board:
        board.send(make_sequence(0, electrodes=64, period_us=20_000))
        display.stop()
        with pytest.raises(BoardStoppedError):
            board.send(make_sequence(0, electrodes=64, period_us=20_000))
    with pytest.raises(BoardStoppedError):
        display.board.open()
    until(lambda: settled(books) == 0)


def test_a_stop_at_any_instant(emulated, make_limits, make_sequence):
    """Whatever a program is doing, opening included: it can do nothing more."""
    port, books = emulated
    for delay_s in (0.0, 0.001, 0.01, 0.03, 0.1):
        board, errors = LinkBoard(port, make_limits(64)), []

        def drive(board=board, errors=errors):
            try:
                with board:
                    for step in range(1000):
                        board.send(make_sequence(step, electrodes=64))
            except BoardError as error:
                errors.append(type(error))

        thread = threading.Thread(target=drive)
        thread.start()
        time.sleep(delay_s)
        stop_all()
        flowed = settled(books)
        thread.join(30)
        assert errors == [BoardStoppedError]
        with pytest.raises(BoardStoppedError):
            LinkBoard(port, make_limits(64)).open()
        assert settled(books) == flowed
        open_boards._stopped = False
        for mark in open_boards.announced.listed():
            if mark.name == "stopped":
                mark.unlink()


def test_two_displays_share_what_one_person_may_get(start):
    first, second = OpenBoard(print, 10.0), OpenBoard(str, 8.0)
    with pytest.raises(BoardError) as refused:
        OpenBoard(repr, 2.5)
    assert (refused.value.about, refused.value.allowed) == ("limits.total_ma", 20.0)
    second.close()
    process = start(
        """
        from smarttouch.boards.open_boards import OpenBoard
        board = OpenBoard(print, 10.0)
        print("begun", flush=True)
        time.sleep(60)
        """
    )
    assert sorted(currents_ma()) == [10.0, 10.0]
    with pytest.raises(BoardError):
        OpenBoard(repr, 0.5)
    process.kill()
    process.wait()
    OpenBoard(repr, 10.0).close()
    first.close()
    assert list(currents_ma()) == []


def test_three_displays_at_full_are_refused(start_emulator, make_limits):
    boards = [LinkBoard(start_emulator()[1], make_limits()) for _ in range(3)]
    with boards[0], boards[1]:
        with pytest.raises(BoardError) as refused:
            boards[2].open()
        assert refused.value.about == "limits.total_ma"
    with boards[2]:
        pass
