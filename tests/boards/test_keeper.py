"""The process that holds a line: it passes bytes, and puts the board at zero when its host is gone.

Real processes are asked for order and outcome, never for durations.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
import tty

import pytest
import serial
from serial import rfc2217

from smarttouch.base.errors import BoardError
from smarttouch.base.wire.port import open_port
from smarttouch.boards.kits import keeper, kept_line
from smarttouch.boards.kits.kept_line import KeptLine

from ..raising import raises
from .fresh import alive, until

pytestmark = pytest.mark.realtime

ZERO = b"these bytes mean zero"
TWICE = ZERO + ZERO


class Board:
    """The far end of a serial port."""

    def __init__(self):
        self.end, slave = os.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)

    def read(self, count=None):
        """Return so many bytes, or all until the port is closed at its other end."""
        heard = b""
        while count is None or len(heard) < count:
            assert select.select([self.end], [], [], 20)[0], f"nothing comes after {heard!r}"
            try:
                heard += os.read(self.end, 65536 if count is None else count - len(heard))
            except OSError:
                break
        return heard


@pytest.fixture
def board():
    board = Board()
    yield board
    os.close(board.end)


@pytest.fixture
def line(board):
    line = KeptLine(open_port(board.name))
    yield line
    line.close()


@pytest.fixture
def promised(line):
    """The line, once it has answered: its handlers are in place, and it knows what zero is."""
    line.promise_zero(ZERO)
    line.timeout = 20
    line.reset_input_buffer()
    return line


def exit_code(line):
    return line._process.wait(20)


def test_bytes_pass_both_ways(board, line):
    line.timeout = 20
    line.write(b"a question")
    assert board.read(10) == b"a question"
    os.write(board.end, b"an answer, and more")
    assert line.read(9) == b"an answer"
    assert line.read(10) == b", and more"


def test_more_than_any_buffer_holds_passes_whole(board, line):
    data = os.urandom(100_000)
    line.timeout = 20
    for start in range(0, len(data), 10_000):
        line.write(data[start : start + 10_000])
        assert board.read(10_000) == data[start : start + 10_000]
    for start in range(0, len(data), 2000):
        os.write(board.end, data[start : start + 2000])
        assert line.read(2000) == data[start : start + 2000]


def test_what_has_come_is_dropped_on_its_way_too(board, line):
    line.timeout = 20
    for number in range(50):
        os.write(board.end, b"late")
        line.reset_input_buffer()
        os.write(board.end, bytes([number]))
        assert line.read(1) == bytes([number])


def test_closing_ends_at_zero_and_lets_go_of_the_port(board, line):
    line.promise_zero(ZERO)
    line.write(b"pattern")
    assert board.read(7) == b"pattern"
    line.close()
    assert board.read() == TWICE
    assert exit_code(line) == keeper.GONE
    open_port(board.name).close()


HOST = """
import sys, time
from smarttouch.boards.kits.kept_line import KeptLine
from smarttouch.base.wire.port import open_port
line = KeptLine(open_port(sys.argv[1]))
line.promise_zero(bytes.fromhex(sys.argv[2]))
line.write(b"pattern")
print(line.process_id, flush=True)
while True:
    time.sleep(1)
"""


@pytest.fixture
def host(board):
    with subprocess.Popen(
        [sys.executable, "-c", HOST, board.name, ZERO.hex()],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as host:
        yield host, int(host.stdout.readline())
        host.kill()


@pytest.mark.parametrize("whom", ["it", "its group"])
def test_a_host_that_is_killed_leaves_zero_and_no_process(board, host, whom):
    process, kept_by = host
    assert board.read(7) == b"pattern"
    kill = os.kill if whom == "it" else os.killpg
    kill(process.pid, signal.SIGKILL)
    assert board.read() == TWICE
    until(lambda: not alive(kept_by))
    open_port(board.name).close()


def test_a_host_that_is_stopped_is_taken_for_gone(board, host):
    process, _ = host
    assert board.read(7) == b"pattern"
    process.send_signal(signal.SIGSTOP)
    try:
        # The host still has the port, so it does not close.
        assert board.read(len(TWICE)) == TWICE
    finally:
        process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_what_a_terminal_sends_does_not_end_it(board, promised, number):
    os.kill(promised.process_id, number)
    for _ in range(3):
        promised.write(b"x")
        assert board.read(1) == b"x"
    assert os.getsid(promised.process_id) == promised.process_id


def why(line):
    """Return what a line that has ended says of it."""
    with pytest.raises(serial.SerialException) as error:
        line.read(1)
    return str(error.value)


def test_sigterm_ends_it_at_zero(board, promised):
    os.kill(promised.process_id, signal.SIGTERM)
    assert board.read(len(TWICE)) == TWICE
    assert exit_code(promised) == keeper.ENDED
    assert promised.at_zero
    assert why(promised) == kept_line._WHY[keeper.ENDED]


def test_where_it_is_killed_this_program_writes_zero(board, promised):
    os.kill(promised.process_id, signal.SIGKILL)
    # Without a call: the heartbeat finds out.
    assert board.read(len(ZERO)) == ZERO
    assert not promised.at_zero
    assert why(promised) not in kept_line._WHY.values()
    assert exit_code(promised) == -signal.SIGKILL


def test_where_its_end_cannot_be_told_this_program_writes_zero(board, promised):
    """As in a program that was started with SIGCHLD ignored: any process ends as with code 0."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        os.kill(promised.process_id, signal.SIGKILL)
        assert board.read(len(ZERO)) == ZERO
        assert not promised.at_zero
        assert exit_code(promised) == 0
    finally:
        signal.signal(signal.SIGCHLD, before)


def test_a_line_that_breaks_is_reported(board, promised):
    end = board.end
    board.end = os.open("/dev/null", os.O_RDONLY)
    os.close(end)
    assert exit_code(promised) == keeper.LINE_LOST
    assert not promised.at_zero
    assert why(promised) == kept_line._WHY[keeper.LINE_LOST]


def test_no_process_to_be_had_is_one_sentence_and_the_port_is_free(board, monkeypatch):
    def refuse(*_, **__):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("smarttouch.boards.kits.kept_line.subprocess.Popen", refuse)
    with raises(BoardError):
        KeptLine(open_port(board.name))
    open_port(board.name).close()


def test_a_computer_that_was_suspended_is_a_host_that_was_silent(monkeypatch):
    port, board = socket.socketpair()
    data, host = socket.socketpair()
    control, controls = socket.socketpair()
    slept_s = [5.0]
    monkeypatch.setattr(keeper, "_slept_s", lambda: slept_s[0])
    with port, board, data, host, control, controls:
        kept = keeper.Keeper(port.fileno(), data.fileno(), control.fileno())
        # No clock that runs during suspend says so here; heartbeats are there without end.
        controls.sendall(keeper.ZERO + len(ZERO).to_bytes(2, "little") + ZERO)
        host.sendall(b"pattern")
        codes = []
        keeping = threading.Thread(target=lambda: codes.append(kept.run()))
        keeping.start()
        beating = threading.Event()
        beats = threading.Thread(target=beat_until, args=(controls, beating))
        beats.start()
        assert board.recv(7) == b"pattern"
        slept_s[0] = 6.0
        keeping.join(20)
        beating.set()
        beats.join()
        assert codes == [keeper.SILENT]
        assert board.recv(1000) == TWICE


def beat_until(controls, end):
    while not end.wait(0.01):
        controls.send(keeper.HEARTBEAT)


def test_a_board_that_takes_no_bytes_does_not_keep_it(board, line, monkeypatch):
    monkeypatch.setattr("smarttouch.boards.kits.kept_line.WRITE_S", 0.1)
    line.promise_zero(ZERO)
    for _ in range(1000):
        try:
            line.write(bytes(100_000))
        except serial.SerialException:
            break
    else:
        pytest.fail("a pseudo-terminal took everything")
    line.close()
    assert exit_code(line) == keeper.BLOCKED


@pytest.mark.parametrize("url", ["loop://", "rfc2217"])
def test_a_line_that_cannot_be_handed_on_is_refused(url):
    port = rfc2217.Serial() if url == "rfc2217" else open_port(url)
    with raises(BoardError):
        KeptLine(port)
