"""Boards of version 3 are spoken to in version 3, whatever else the program can."""

import numpy as np

from smarttouch.boards.emulator.delivery_log import read_slots
from smarttouch.boards.link_protocol import HALF, NEWEST, VERSION, Kind
from smarttouch.boards.link_session import HostSession, decode, encode
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from smarttouch.wire.framing import Deframer
from tests.boards.fresh import fresh_state
from tests.firmware.scenes import random_lists, random_table, sequence_of


def test_a_board_of_version_3_is_driven_as_ever(
    start_emulator, tmp_path, make_limits, make_sequence
):
    _, port = start_emulator(f"--books={tmp_path}", "--link-version=3")
    rng = np.random.default_rng(0)
    table = random_table(rng, 9, 8)
    sequence = sequence_of(random_lists(rng, table, 5), time_ns=10**9)
    with make_board(f"link:{port}", make_limits(), Output(kind="weighted")) as board:
        assert board._line.session.version == VERSION
        # It keeps none: everything goes as currents.
        board.keep_kernels(table)
        board.send(make_sequence(0))
        board.drain()
        board.send(sequence)
        board.drain()
        assert (board.report().sequences, board.report().violations) == (2, 0)
        assert fresh_state(tmp_path)["unsafe"] == 0
    np.testing.assert_array_equal(read_slots(tmp_path)["current_ua"], sequence.current_ua)


def test_an_old_board_does_not_read_the_half_of_a_newer_hello():
    session = HostSession(lambda: 7, NEWEST)

    def hear(half, about, version, number=0):
        packet = encode(Kind.CAPABILITIES, 5 << 32 | half, number, 0, about, b"", version)
        return session.take(Deframer().feed(packet)[0])

    (hello,) = Deframer().feed(session.encode(Kind.HELLO))
    assert decode(hello).version == NEWEST
    # Of another session, or about nothing asked.
    assert hear(9, 1, VERSION) is hear(0, 2, VERSION) is None
    assert session.version == NEWEST
    assert hear(0, 1, VERSION) is not None
    assert (session.version, session.number) == (VERSION, 7)
    assert hear(0, 1, VERSION) is None, "a repetition"
    (again,) = Deframer().feed(session.encode(Kind.HELLO))
    assert (decode(again).version, decode(again).session) == (VERSION, 7)
    assert hear(7, 2, VERSION) is not None
    assert session.number == 5 << 32 | 7 & HALF
