"""Ports are opened, or the reason is one a user can act on."""

import socket

import pytest

from smarttouch.errors import BoardError
from smarttouch.wire.port import open_port, reopen_port


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("/dev/nowhere", "no such port"),
        ("/dev/null", "no serial port"),
        ("tcp://127.0.0.1", "give tcp://HOST:PORT"),
        ("tcp://127.0.0.1:99999", "tcp://127.0.0.1:99999"),
        ("nonsense://x", "nonsense"),
    ],
)
def test_what_cannot_be_opened_is_named(name, says):
    with pytest.raises(BoardError, match=says) as error:
        open_port(name)
    assert "\n" not in str(error.value)


def test_an_address_where_nobody_listens():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(BoardError, match="nobody listens there"):
        open_port(f"tcp://127.0.0.1:{port}")


def test_short_writes_over_tcp_do_not_wait():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        board, _ = server.accept()
        with board:
            assert port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
            port.write(b"ab")
            assert board.recv(10) == b"ab"
            port.close()


def test_a_port_that_stays_away_is_not_waited_for_longer_than_asked():
    with pytest.raises(BoardError, match="no such port"):
        reopen_port("/dev/nowhere", 0.12)
