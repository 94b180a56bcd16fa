"""Nothing waits for a terminal that has stopped reading."""

import io
import os
import sys
import threading

import pytest
from rich.console import Console

from smarttouch.base.terminal import MOST_WAITING, Outlet, never_waiting

PATIENCE_S = 20


@pytest.fixture
def pipe():
    """A pipe that is full: its reading and its writing end."""
    ends = os.pipe()
    os.set_blocking(ends[1], False)
    with pytest.raises(BlockingIOError):
        os.writev(ends[1], [bytes(1 << 16)] * 2) and os.write(ends[1], b".")
    os.set_blocking(ends[1], True)
    yield ends
    for end in ends:
        os.close(end)


def emptied(end, until=b"last"):
    read = b""
    while until not in read:
        read += os.read(end, 1 << 16)
    return read.lstrip(b"\0")


@pytest.fixture
def printing(monkeypatch):
    """Return a setter of where this process prints to."""

    def set_streams(end):
        for name in ("stdout", "stderr"):
            stream = os.fdopen(end, "w", buffering=1, closefd=False)
            monkeypatch.setattr(sys, name, stream)

    return set_streams


def test_what_is_printed_waits_in_its_place_and_comes_in_order(pipe, printing):
    printing(pipe[1])
    with never_waiting(lambda: True):
        print("first")
        print("second", file=sys.stderr)
        Console().print("third")
        Console(stderr=True).print("last")
        assert emptied(pipe[0]) == b"first\nsecond\nthird\nlast\n"


def test_the_end_of_a_run_that_was_stopped_waits_for_nobody(pipe, printing):
    printing(pipe[1])
    own = sys.stdout
    with never_waiting(lambda: True):
        print("nobody reads this")
    assert sys.stdout is own


def printed(text, stopped):
    """Print in a thread; return an event that is set when all of it has gone, or is given up."""
    over = threading.Event()

    def run():
        with never_waiting(stopped):
            print(text)
        over.set()

    threading.Thread(target=run, daemon=True).start()
    return over


def test_the_end_of_a_run_that_was_not_waits_until_it_is_stopped(pipe, printing):
    printing(pipe[1])
    stop = threading.Event()
    over = printed("last", stop.is_set)
    assert not over.wait(0.3)
    stop.set()
    assert over.wait(PATIENCE_S)


def test_the_end_waits_until_all_is_read(pipe, printing):
    printing(pipe[1])
    over = printed("x" * 70_000 + "last", lambda: False)
    assert len(emptied(pipe[0])) >= 70_004
    assert over.wait(PATIENCE_S)


def test_what_is_too_much_is_dropped(pipe):
    outlet = Outlet()
    for _ in range(100):
        outlet.put(pipe[1], bytes(10_000))
    assert outlet._size <= MOST_WAITING + 10_000
    assert not outlet.drain(0.0)
    outlet.close()


def test_who_reads_no_more_is_an_error_of_who_prints():
    ours, theirs = os.pipe()
    os.close(ours)
    outlet = Outlet()
    outlet.put(theirs, b"a")
    with pytest.raises(BrokenPipeError):
        outlet.drain(PATIENCE_S)
    outlet.close()
    os.close(theirs)


def test_what_is_no_file_is_left_alone(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stdout", stream)
    with never_waiting(lambda: False):
        assert sys.stdout is stream
        print("text")
    assert stream.getvalue() == "text\n"
