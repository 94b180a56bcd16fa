"""Boards are found without a byte to anything unknown."""

import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards import open
from smarttouch.boards.open import NetworkBoard, network_boards, parse_answer, serial_ports


def test_an_answer_is_a_board():
    answer = b"ETK!;id=A1B2C3;name=bench;ip=192.168.4.1;port=8080;mode=AP;busy=1;fw=1.0"
    assert parse_answer(answer) == NetworkBoard("etactilekit:tcp://192.168.4.1:8080", "bench", True)


def test_without_a_name_its_number_is_one():
    assert parse_answer(b"ETK!;id=A1B2C3;ip=10.0.0.7;port=8080").name == "A1B2C3"


@pytest.mark.parametrize("answer", [b"", b"ETK?", b"ETK!;ip=1.2.3.4", b"ETK!;ip=1.2.3.4;port=x"])
def test_what_is_no_answer_is_no_board(answer):
    assert parse_answer(answer) is None


@given(st.binary(max_size=200))
def test_any_bytes_are_survived_and_none_steers_the_terminal(data):
    board = parse_answer(b"ETK!;ip=\x1b[2Jhost;port=1;name=" + data)
    if board is not None:
        assert (board.url + board.name).isprintable()


def test_boards_answer_over_the_network():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
        board.bind(("127.0.0.1", 0))
        heard = []

        def answer():
            question, host = board.recvfrom(100)
            heard.append(question)
            board.sendto(b"nonsense", host)
            board.sendto(b"ETK!;id=1;name=kit;ip=127.0.0.1;port=8080", host)

        thread = threading.Thread(target=answer)
        thread.start()
        found = network_boards(0.3, "127.0.0.1", board.getsockname()[1])
        thread.join()
    assert heard == [b"ETK?"]
    assert found == [NetworkBoard("etactilekit:tcp://127.0.0.1:8080", "kit", False)]


def test_serial_ports_are_listed_and_none_is_opened(monkeypatch):
    class Found:
        def __init__(self, device, description):
            self.device, self.description = device, description

    monkeypatch.setattr(
        open.list_ports,
        "comports",
        lambda: [Found("/dev/ttyUSB1", "CP2102"), Found("/dev/ttyS0", "n/a")],
    )
    assert [(port.device, port.description) for port in serial_ports()] == [
        ("/dev/ttyUSB1", "CP2102")
    ]
