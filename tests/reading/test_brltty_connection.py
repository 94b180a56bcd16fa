"""The connection to BRLTTY: where it is met, and that it is made again."""

import socket

import pytest

from smarttouch.base.errors import SourceError
from smarttouch.reading.brltty_connection import USUAL_PORT, Address, BrlttyConnection
from tests.reading.real_brltty import free_port, wait_until

from ..raising import raises

HANGS_S = 60


@pytest.mark.parametrize(("text", "host", "port", "listens"), [
    ("", "127.0.0.1", USUAL_PORT, True), ("listen", "127.0.0.1", USUAL_PORT, True),
    ("listen:4101", "127.0.0.1", 4101, True), ("listen:0.0.0.0:4101", "0.0.0.0", 4101, True),
    ("desk.local:4101", "desk.local", 4101, False), ("[::1]:4101", "::1", 4101, False),
])  # fmt: skip
def test_addresses(text, host, port, listens):
    assert Address.parse(text) == Address(host, port, listens)


@pytest.mark.parametrize("text", ["listen:0", "listen:70000", "desk:x", "desk:-1"])
def test_what_is_no_address(text):
    with raises(SourceError, value=text):
        Address.parse(text)


@pytest.mark.parametrize("cells", [0, 256])
def test_impossible_widths(cells):
    with raises(SourceError, names="cells"):
        BrlttyConnection(Address("127.0.0.1", 1, False), cells)


@pytest.mark.parametrize("host", ["127.0.0.1", "a..b"])
def test_nobody_there(host):
    with raises(SourceError):
        BrlttyConnection(Address(host, free_port(), False), 20).open()


def test_a_port_that_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with raises(SourceError):
            BrlttyConnection(Address("127.0.0.1", port, True), 20).open()


@pytest.fixture
def connection():
    """Return an open connection that listens."""
    made = BrlttyConnection(Address("127.0.0.1", free_port(), True), 7).open()
    yield made
    made.close()


def updated(connection, number):
    """Wait until the cells have been updated this many times; return whether they have."""

    def holds():
        shown = connection.shown
        return shown is not None and shown.number >= number

    return wait_until(holds, HANGS_S)


def connect(connection):
    """Return BRLTTY's end, once it has been sent the width."""
    end = socket.create_connection(("127.0.0.1", connection.address.port), timeout=HANGS_S)
    assert end.recv(100) == b"cells 7\r\n"
    return end


def test_it_is_made_again_whenever_it_is_lost(connection):
    for number in range(1, 4):
        with connect(connection) as end:
            end.sendall(f'Braille "{number % 8 + 1}"\r\n'.encode())
            assert updated(connection, number)
            assert connection.shown.cells == chr(0x2800 + (1 << number % 8))
        assert wait_until(lambda: connection.shown is None, HANGS_S)


def test_a_connection_to_brltty_is_made_again():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = Address("127.0.0.1", listener.getsockname()[1], False)
        connection = BrlttyConnection(address, 7).open()
        for number in (1, 2, 3):
            with listener.accept()[0] as end:
                end.settimeout(HANGS_S)
                assert end.recv(100) == b"cells 7\r\n"
                end.sendall(b'Braille "1"\r\n')
                assert updated(connection, number)
        connection.close()


def test_commands_arrive_and_without_a_connection_are_dropped(connection):
    connection.send("lndn")
    with connect(connection) as end:
        end.sendall(b'Braille "1"\r\n')
        assert updated(connection, 1)
        connection.send("route 3")
        assert end.recv(100) == b"route 3\r\n"
