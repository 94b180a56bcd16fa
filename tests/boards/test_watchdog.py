"""The watchdog, which shares a port and sets the board to zero when its host is gone.

Tests with real processes check the order and the result of writes, never durations.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
import tty
from pathlib import Path

import pytest
import serial
from serial import rfc2217

from smarttouch.base.clock import now_ns
from smarttouch.base.errors import BoardError
from smarttouch.base.wire.port import open_port
from smarttouch.boards.kits import etactilekit_protocol, watchdog
from smarttouch.boards.kits.etactilekit_protocol import WatchedPort

from ..support.checks import raises
from .emulator_waits import until

pytestmark = pytest.mark.realtime

ZERO = b"these bytes mean zero"
TWICE = ZERO + ZERO


class Board:
    """Device side of a serial port."""

    def __init__(self):
        self.end, slave = os.openpty()
        tty.setraw(slave)
        self.name = os.ttyname(slave)
        os.close(slave)

    def read(self, count=None):
        """Return ``count`` bytes, or all bytes until the host closes the port."""
        heard = b""
        while count is None or len(heard) < count:
            assert select.select([self.end], [], [], 20)[0], f"no byte comes after {heard!r}"
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
def port(board):
    port = WatchedPort(open_port(board.name), ZERO)
    yield port
    port.close()


HOST = """
import sys, time
from smarttouch.boards.kits.etactilekit_protocol import WatchedPort
from smarttouch.base.wire.port import open_port
port = WatchedPort(open_port(sys.argv[1]), bytes.fromhex(sys.argv[2]))
port.arm()
port.write(b"pattern")
print(flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("armed", [True, False])
def test_closing_ends_at_zero_and_lets_go_of_the_port(board, port, armed):
    """An unarmed watchdog writes nothing, because the device may be a wrong one."""
    if armed:
        port.arm()
    port.write(b"pattern")
    assert board.read(7) == b"pattern"
    port.close()
    assert board.read() == (TWICE if armed else b"")
    assert port._process.wait(20) == watchdog.GONE
    open_port(board.name).close()


def test_a_host_that_is_stopped_counts_as_gone(board):
    command = [sys.executable, "-c", HOST, board.name, ZERO.hex()]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, start_new_session=True) as host:
        host.stdout.readline()
        assert board.read(7) == b"pattern"
        host.send_signal(signal.SIGSTOP)
        try:
            assert board.read(len(TWICE)) == TWICE
        finally:
            host.kill()


@pytest.mark.parametrize("stale", [False, True])
def test_a_host_that_stood_still_writes_nothing_any_more(board, port, monkeypatch, stale):
    """A host writes nothing once its watchdog has ended, or may have ended (``stale``)."""
    port.arm()
    if stale:
        monkeypatch.setattr(etactilekit_protocol, "STALE_NS", 0)
    monkeypatch.setattr(port, "_send_beat", lambda: None)
    if not stale:
        until(lambda: port.at_zero)
    with pytest.raises(serial.SerialException):
        port.write(b"pattern")
    assert board.read(len(TWICE)) == TWICE
    until(lambda: port.at_zero)
    port.close()
    assert board.read() == b""


def test_zero_follows_what_was_written_after_the_watchdog_s_zero(board, port, monkeypatch):
    """The program pauses between its check of the watchdog and its write."""
    write = port._port.write

    def late(data):
        if data == b"pattern":
            until(lambda: port.at_zero)
        return write(data)

    port.arm()
    monkeypatch.setattr(port, "_send_beat", lambda: None)
    monkeypatch.setattr(port._port, "write", late)
    with pytest.raises(serial.SerialException):
        port.write(b"pattern")
    port.close()
    heard = board.read()
    assert heard == TWICE + b"pattern" + TWICE


def test_a_program_that_was_suspended_writes_nothing_any_more(board, port, monkeypatch):
    port.arm()
    port.write(b"pattern")
    # Simulate a suspend of the computer, during which only this clock runs.
    monkeypatch.setattr(etactilekit_protocol, "now_ns", lambda: now_ns() + 5 * 10**9)
    with pytest.raises(serial.SerialException):
        port.write(b"another")
    port.close()
    assert board.read() == b"pattern" + TWICE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP, signal.SIGTERM])
def test_signals_do_not_end_it(board, port, number):
    port.arm()
    status = Path(f"/proc/{port._process.pid}/status")

    def ignored():
        return int(status.read_text().partition("SigIgn:")[2].split()[0], 16)

    until(lambda: ignored() >> (number - 1) & 1)
    os.kill(port._process.pid, number)
    port.write(b"x")
    assert board.read(1) == b"x"
    assert os.getsid(port._process.pid) == port._process.pid
    port.close()
    assert board.read() == TWICE


@pytest.mark.parametrize("ignored", [False, True])
def test_where_it_is_killed_this_program_writes_zero(board, port, ignored):
    """The program writes zero even if it ignores SIGCHLD, which hides the watchdog's exit code."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        port.arm()
        os.kill(port._process.pid, signal.SIGKILL)
        # The heartbeat thread notices that the watchdog has ended.
        assert board.read(len(ZERO)) == ZERO
        assert not port.at_zero
        with pytest.raises(serial.SerialException):
            port.write(b"pattern")
    finally:
        signal.signal(signal.SIGCHLD, before)


@pytest.mark.parametrize("url", ["loop://", "rfc2217", "no process"])
def test_a_port_that_cannot_be_watched_is_refused_and_free(board, monkeypatch, url):
    def refuse(*_, **__):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    if url == "no process":
        monkeypatch.setattr(etactilekit_protocol.subprocess, "Popen", refuse)
    port = rfc2217.Serial() if url == "rfc2217" else open_port(url if ":" in url else board.name)
    with raises(BoardError):
        WatchedPort(port, ZERO)
    open_port(board.name).close()


@pytest.mark.parametrize("suspended", [True, False])
def test_a_suspended_computer_is_a_silent_host_and_a_stuck_board_ends_it(monkeypatch, suspended):
    port, board = socket.socketpair()
    control, controls = socket.socketpair()
    slept_s, codes = [5.0], []
    monkeypatch.setattr(watchdog, "_slept_s", lambda: slept_s[0])
    monkeypatch.setattr(watchdog, "STUCK_S", 0.05)
    # The host timeout must exceed the time between heartbeats, but not the suspend of 1 s.
    monkeypatch.setattr(watchdog, "SILENCE_S", 0.9)
    port.setblocking(False)
    with port, board, control, controls:
        ends = port.fileno(), control.fileno(), ZERO
        watching = threading.Thread(target=lambda: codes.append(watchdog.watch(*ends)))
        watching.start()
        controls.send(b".")
        if suspended:
            # Report a suspend of 1 s, and send a heartbeat nevertheless.
            slept_s[0] = 6.0
            controls.send(b".")
        else:
            # A second heartbeat does not end the watchdog.
            for _ in range(2):
                until(lambda: codes or not select.select([control], [], [], 0)[0])
                controls.send(b".")
            assert not select.select([board], [], [], 0.02)[0]
            while select.select([], [port], [], 0)[1]:
                port.send(bytes(100_000))
            controls.close()
        watching.join(20)
        assert codes == [watchdog.SILENT if suspended else watchdog.BLOCKED]
        if suspended:
            assert board.recv(1000) == TWICE
