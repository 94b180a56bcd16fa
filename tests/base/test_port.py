"""Ports: opening by name, identity of the device, and writes before a deadline."""

import contextlib
import os
import socket
import threading

import pytest

from smarttouch.base.errors import BoardError, OtherDeviceError
from smarttouch.base.wire.port import (
    LINE_ERRORS,
    UsbIdentity,
    identity_of,
    open_port,
    read_some,
    reopen_port,
    write_before,
)
from smarttouch.emulator.device_lines import PtyLine

from ..support.checks import raises


@pytest.mark.parametrize("name", [
    "/dev/nowhere", "/dev/null", "tcp://127.0.0.1", "tcp://127.0.0.1:99999", "nonsense://x",
])  # fmt: skip
def test_what_cannot_be_opened_is_named(name):
    with raises(BoardError, value=name) as error:
        open_port(name)
    assert name in str(error.value)


@pytest.mark.parametrize("scheme", ["tcp", "socket"])
def test_short_writes_over_tcp_do_not_wait(scheme):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"{scheme}://127.0.0.1:{server.getsockname()[1]}")
        board, _ = server.accept()
        with board:
            assert port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            port.write(b"ab")
            assert board.recv(10) == b"ab"
            assert identity_of(port) is None
            port.close()


@pytest.fixture
def plugged(tmp_path, usb_ports):
    """Return a function that plugs in a device and returns the port's name and the device's end."""
    ends, name = [], tmp_path / "port"

    def plug(**usb):
        far, near = os.openpty()
        os.set_blocking(far, False)
        ends.extend((far, near))
        name.unlink(missing_ok=True)
        if usb:
            usb_ports(os.ttyname(near), **usb)
        name.symlink_to(os.ttyname(near))
        return str(name), far

    yield plug
    for end in ends:
        os.close(end)


def heard(far):
    try:
        return os.read(far, 100)
    except BlockingIOError:
        return b""


def test_usb_identifies_the_device_of_a_port_whatever_its_name(plugged):
    name, _ = plugged(vid=0x303A, pid=0x1001, serial_number="A1B2C3", location="1-2:1.2")
    with open_port(name) as port:
        assert identity_of(port) == UsbIdentity(0x303A, 0x1001, "A1B2C3", "1.2")


@pytest.mark.parametrize("usb", [{}, {"vid": 0x1A86, "pid": 0x7523, "serial_number": None}])
def test_without_a_serial_number_nobody_is_known(plugged, usb):
    name, _ = plugged(**usb)
    with open_port(name) as port:
        assert identity_of(port) is None


KNOWN = {"vid": 1, "pid": 2, "serial_number": "3", "location": "1-1:1.0"}


@pytest.mark.parametrize(("before", "after"), [
    *((KNOWN, KNOWN | change) for change in ({"vid": 7}, {"pid": 7}, {"serial_number": "7"})),
    (KNOWN, KNOWN | {"location": "1-1:1.2"}),
    (KNOWN, {}),
    ({}, KNOWN),
])  # fmt: skip
def test_another_device_in_a_ports_place_is_not_opened_for_writing(plugged, before, after):
    name, _ = plugged(**before)
    with open_port(name) as port:
        identity = identity_of(port)
    _, far = plugged(**after)
    with raises(OtherDeviceError, value=name):
        reopen_port(name, 0.12, identity)
    assert heard(far) == b""


def test_the_same_device_is_waited_for_while_another_is_there(plugged):
    name, _ = plugged(**KNOWN)
    with open_port(name) as port:
        identity = identity_of(port)
    plugged(**KNOWN | {"serial_number": "7"})
    # At another USB port and under another system name, it is still the same device.
    back = threading.Timer(0.2, plugged, kwargs=KNOWN | {"location": "3-4:1.0"})
    back.start()
    with reopen_port(name, 20, identity) as port:
        assert identity_of(port) == identity
    back.join()


class Pipe:
    """Port that writes to a pipe."""

    def __init__(self):
        self.end, self._number = os.pipe()
        os.set_blocking(self._number, False)
        self.rest = b""

    def fileno(self):
        return self._number

    def write(self, data):
        self.rest += data

    def close(self):
        os.close(self.end)
        os.close(self._number)


@pytest.fixture
def pipe():
    pipe = Pipe()
    yield pipe
    pipe.close()


@pytest.mark.parametrize(("now_ns", "goes"), [(4, True), (5, True), (6, False)])
def test_bytes_go_in_time_or_not_at_all(pipe, now_ns, goes):
    assert write_before(pipe, b"packet", 5, lambda: now_ns) is goes
    write_before(pipe, b".", 1, lambda: 0)
    assert os.read(pipe.end, 100) == (b"packet." if goes else b".")


def test_a_port_without_a_descriptor_is_written_to_in_time(monkeypatch, pipe):
    def none():
        raise OSError("no descriptor")

    monkeypatch.setattr(pipe, "fileno", none)
    in_time = [write_before(pipe, b"packet", 5, lambda now=now: now) for now in (5, 6)]
    assert in_time == [True, False]
    assert pipe.rest == b"packet"
    with open_port("loop://") as port:
        port.write(b"answer")
        assert read_some(port) == b"answer"


def fill(pipe):
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(pipe.fileno(), bytes(4096))


def test_a_line_that_takes_nothing_is_a_fault(pipe):
    fill(pipe)
    with pytest.raises(LINE_ERRORS):
        write_before(pipe, b"packet", 5, lambda: 0, 0.01)


def test_what_had_to_wait_for_the_line_is_looked_at_again(pipe):
    """If a packet's deadline passes while the line is full, the packet is not written."""
    fill(pipe)
    times = iter([0, 6])

    def now_ns():
        now = next(times)
        if now == 0:
            threading.Timer(0.05, os.read, (pipe.end, 1 << 20)).start()
        return now

    assert write_before(pipe, b"packet", 5, now_ns, 20.0) is False
    assert pipe.rest == b""


def test_waiting_for_a_port_ends_when_the_waiter_is_stopped():
    class StoppedError(Exception):
        pass

    def stop(_seconds):
        raise StoppedError

    with pytest.raises(StoppedError):
        reopen_port("/dev/nowhere", 600.0, None, stop)


def test_bytes_that_another_program_has_taken_are_no_loss(monkeypatch):
    line = PtyLine()
    port = open_port(line.name)
    # `select` reports bytes, but another program has taken them before the read.
    monkeypatch.setattr("select.select", lambda *_: ([port], [], []))
    assert read_some(port) is None
    line.close()
    with pytest.raises(LINE_ERRORS):
        read_some(port)
