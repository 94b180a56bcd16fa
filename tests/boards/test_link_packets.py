"""Packets of ``link`` at the host: encoding, silent boards, scans in parts, and conversion of the
board's time."""

import itertools
import struct
import time
import zlib
from dataclasses import replace

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from firmware.tests.core_and_emulator import encode_lists
from firmware.tests.random_histories import random_table, sequence_of
from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.base.wire.framing import LARGEST_PACKET, Deframer, WirePacket
from smarttouch.boards import link as protocol
from smarttouch.boards.board import Board
from smarttouch.boards.link import (
    WHOLE_HEAD_BYTES,
    Message,
    MessageKind,
    decode,
    encode,
)
from smarttouch.boards.link.link_driver import LISTENED_S, LinkSession
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.emulator.link_board_limits import Room
from smarttouch.emulator.link_packets import decode_head, decode_lists
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.scan_sequence import KernelLists, ScanSequence

from ..support.checks import raises
from ..support.full import sample
from .emulator_waits import until

MS = 1_000_000
currents = hnp.arrays(
    np.int16, st.tuples(st.integers(0, 6), st.integers(1, 11)), elements=st.integers(-5000, 5000)
)


def columns(current, seed=0):
    slots = len(current)
    random = np.random.default_rng(seed)
    return [random.integers(0, 65536, slots).astype(np.uint16) for _ in range(3)]


def sequence_payload(
    output, period_us, width_us, discharge_us, site, current_ua, times=1, measure=False
):  # fmt: skip
    """Return the payload of a SEQUENCE at full intensity, without kernels."""
    columns = [np.asarray(each, np.uint16) for each in (width_us, discharge_us, site)]
    sequence = ScanSequence(np.asarray(current_ua, np.int16), *columns, period_us, 1.0, 0)
    return encode_lists(sequence, times, measure, output != "weighted", None, 1 << 20)


@pytest.mark.parametrize("output", ["three-state", "one-against-all"])
@given(current=currents)
def test_switched_survives_the_wire(output, current):
    payload = sequence_payload(output, 9000, *columns(current), current)
    wire = decode_lists(payload, current.shape[1], True)
    np.testing.assert_array_equal(wire.rows, np.sign(current))
    np.testing.assert_array_equal(wire.source_ua, np.maximum(current, 0).sum(axis=1))


def test_a_slot_beyond_the_room_of_a_packet_is_refused():
    column = np.full(600, 100, np.uint16)
    current = np.zeros((600, 1024), np.int16)
    sequence = ScanSequence(current, column, column, 0 * column, 9000, 1.0, 0)
    with raises(BoardError, allowed=2000):
        encode_lists(sequence, 1, False, False, None, 2000)


@pytest.mark.parametrize("amplitude", [[40_000, 30_000], [4000] + 70_000 * [0]])
def test_lists_beyond_what_a_board_adds_up_go_as_currents(amplitude):
    table, count = random_table(np.random.default_rng(0), 1, 4), len(amplitude)
    lists = KernelLists(table, np.array([0, count]), *np.uint16([[0] * count, amplitude]))
    image, switched = KernelImage.of(table, 1 << 20, 9), False
    payloads = [
        encode_lists(sequence_of(lists), 1, False, switched, each, 1 << 20)
        for each in (image, None)
    ]
    assert payloads[0] == payloads[1]


def test_a_switched_board_that_claims_a_recharge_phase_gets_none(make_limits, monkeypatch):
    """A switched board has only one current source, but a recharge needs one for each electrode."""
    limits, output = make_limits(), Output(kind="one-against-all")
    said, able = LinkFirmware._capabilities, 27

    def claim(board):
        return said(board).replace(bytes([able]), bytes([able | protocol.Feature.RECHARGE]), 1)

    monkeypatch.setattr(LinkFirmware, "_capabilities", claim)
    with Board(SimulatedDriver("", limits, output), limits, output, on_a_finger=False) as board:
        assert not board.capabilities.recharges


def test_an_endless_packet_does_not_fill_the_memory():
    deframer = Deframer()
    for _ in range(12):
        list(deframer.feed(b"\x01" * 2**20))
    assert len(deframer.waiting) <= LARGEST_PACKET * 1.1
    assert list(deframer.feed(b"\0")) == []
    assert len(list(deframer.feed(encode(Message(MessageKind.STOP, 1, 1))))) == 1


@given(current=currents, seed=st.integers(0, 9), shapes=st.integers(1, 3), measure=st.booleans())
def test_the_bytes_are_those_of_a_plain_encoder(current, seed, shapes, measure):
    _, _, site = columns(current, seed)
    shape = np.random.default_rng(seed).integers(0, shapes, len(current)).tolist()
    # Shapes 0 and 1 differ only in their discharge.
    width, rest = [100 + each // 2 for each in shape], [50 + each for each in shape]
    used = sorted(set(shape))
    plain = struct.pack("<IHHBB", 9000, 3, 0xFFFF, measure, len(used))
    plain += b"".join(struct.pack("<HH", 100 + each // 2, 50 + each) for each in used)
    slots = zip(shape, site.tolist(), current.tolist(), strict=True)
    for each, group in itertools.groupby(slots, key=lambda slot: slot[0]):
        rows = [struct.pack(f"<H{len(row)}h", own, *row) for _, own, row in group]
        plain += struct.pack("<BBH", 2, used.index(each), len(rows)) + b"".join(rows)
    assert sequence_payload("weighted", 9000, width, rest, site, current, 3, measure) == plain
    body = struct.pack("<BBIBQII", protocol.VERSION, MessageKind.SEQUENCE, 7, 0, 5, 6, 4) + plain
    packet = encode(Message(MessageKind.SEQUENCE, 7, 5, 6, 4, plain))
    assert cobs.decode(packet[:-1]) == body + struct.pack("<I", zlib.crc32(body))


@given(payload=st.binary(max_size=600), cut=st.integers(0, 700), session=st.integers(0, 2**64 - 1))
def test_the_head_of_a_packet_is_known_before_its_end(payload, cut, session):
    data = encode(Message(MessageKind.SEQUENCE, 258, session, 0, 7, payload))
    deframer = Deframer()
    list(deframer.feed(data[: min(cut, len(data) - 1)]))
    assert len(deframer.waiting) == min(cut, len(data) - 1)
    head = deframer.head(WHOLE_HEAD_BYTES)
    if head is None:
        assert cut <= WHOLE_HEAD_BYTES
    else:
        message = decode_head(head)
        assert (message.kind, message.session) == (MessageKind.SEQUENCE, session)
        assert (message.number, message.heard, message.about) == (258, 0, 7)
        assert decode_head(b"\4" + head[1:]).version == 4


def test_what_is_too_short_belongs_to_no_session():
    for length in range(16):
        message = decode(WirePacket(MessageKind.STOP, 9, bytes([1] * length), protocol.VERSION))
        assert (message.session, message.payload) == (0, b"")


def test_when_numbers_run_out_another_session_is_needed(monkeypatch):
    monkeypatch.setattr("smarttouch.boards.link.link_driver.LAST_NUMBER", 2)
    session = LinkSession(None)
    for _ in range(2):
        session.encode(MessageKind.HEARTBEAT)
    with raises(LineLostError, names="packets", allowed=2):
        session.encode(MessageKind.HEARTBEAT)


SAYS = "says it is alive"


class Reads:
    """Line whose reads return one piece each, and then the last piece for ever. If a piece is a
    number, the read lasts that many seconds and returns no bytes."""

    name = "here"
    now_ns = write = None

    def __init__(self, packets, *pieces):
        self.packets, self.pieces, self.number = packets, list(pieces), 0

    def read_some(self):
        piece = self.pieces.pop(0) if len(self.pieces) > 1 else self.pieces[0]
        time.sleep(piece if isinstance(piece, float) else 0.02)
        if piece == SAYS:
            self.number += 1
            session, payload = self.packets.number, protocol.ALIVE.pack(0)
            return encode(Message(MessageKind.ALIVE, self.number, session, payload=payload))
        return piece if isinstance(piece, bytes) else b""

    def lost(self, what):
        return LineLostError(f"the board at {self.name} {what}")


SILENCE_S = 2.5 * LISTENED_S
"""Silence after which a board is gone. Two delayed reads count as only 2 * LISTENED_S."""


@pytest.mark.realtime
@pytest.mark.parametrize(("pieces", "begun", "is_gone"), sample([
    # The board is not gone: this program pauses, or the session has not begun.
    ([SAYS, 2 * SILENCE_S, b"", SAYS], True, False),
    ([b""], False, False),
    ([SAYS, b""], True, True),
    ([SAYS, b"nothing whole"], True, True),
]))  # fmt: skip
def test_a_silent_board_is_gone(pieces, begun, is_gone):
    packets = LinkSession(lambda message: None)
    packets.open(Reads(packets, *pieces))
    packets.begun, packets.silence_s = begun, SILENCE_S
    try:
        if is_gone:
            until(lambda: packets.fault is not None)
            with raises(LineLostError, names="board", value="here"):
                raise packets.fault
        else:
            time.sleep(3 * SILENCE_S)
            assert packets.fault is None
    finally:
        packets.close()


class SmallDriver(SimulatedDriver):
    room = Room(4, 128, 300, 5)


def made_scan(rng, table, step):
    """Return a scan of 1 to 11 slots, from kernels or currents. Some scans have a recharge."""
    count = int(rng.integers(1, 12))
    size = rng.integers(1, 4, count)
    first = np.concatenate([[0], size.cumsum()])
    kernel = rng.integers(0, len(table.weights), first[-1]).astype(np.uint16)
    lists = KernelLists(table, first, kernel, rng.integers(0, 400, first[-1]).astype(np.uint16))
    scan = sequence_of(lists, time_ns=step * 10**9, intensity=1.0, period_us=20_000)
    if step % 3 == 0:
        width_us = rng.choice([60, 100, 200], count).astype(np.uint16)
        scan = replace(scan, sums=None, width_us=width_us)
    if step % 4 == 0:
        return replace(scan, recharge_us=200, recharge_ua=np.zeros(8, np.int16))
    return scan


@pytest.mark.parametrize("seed", range(3))
def test_what_a_small_board_delivers_is_what_a_large_one_does(make_limits, seed):
    """Both boards have exactly the same voltages, counters, currents and pulse widths."""
    rng = np.random.default_rng(seed)
    table, found = random_table(rng, 12, 8), []
    scans = [made_scan(rng, table, step) for step in range(1, 16)]
    fields = ("current_ua", "width_us", "discharge_us", "site")
    none = {name: getattr(scans[0], name)[:0] for name in fields}
    for kind in (SimulatedDriver, SmallDriver):
        limits = make_limits()
        own = {"on_a_finger": False, "claimed_time": True, "simulated_time": True}
        with Board(kind("", limits), limits, **own) as board:
            board.keep_kernels(table)
            board.send(replace(scans[0], sums=None, time_ns=0, intensity=0, **none))
            numbers = [board.send(scan) for scan in scans]
            volts = [volts.tolist() for _, volts in board.take_volts()]
            report = board.report()
            assert all(board.start_of(number) is not None for number in numbers)
            if kind is SmallDriver:
                longest = max(scans, key=lambda scan: scan.slots)
                with raises(BoardError):
                    board.send(replace(longest, time_ns=20 * 10**9), times=2)
        found.append((volts, report, *(each.tolist() for each in board.driver.take_pulses()[1:])))
    assert found[0] == found[1]
    assert found[0][1].slots == sum(scan.slots for scan in scans)


@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.integers(0, 20), st.sampled_from([0, 0, 0, 50])),
        min_size=1,
    ),
    st.integers(0, 10**6),
)
def test_no_sequence_begins_before_it_was_sent_or_after_its_answer(sequences, first_us):
    session, sent_ns, behind_us = LinkSession(None), 10**9, 0
    for waits_ms, answers_ms, stands_still_ms in sequences:
        behind_us += 1000 * stands_still_ms
        sent_ns += stands_still_ms * MS
        began_ns = sent_ns + waits_ms * MS
        board_us = began_ns // 1000 + first_us - behind_us
        time_ns = session.start_ns(board_us, sent_ns, began_ns + answers_ms * MS)
        assert sent_ns <= time_ns <= began_ns + answers_ms * MS
        sent_ns = began_ns + 20 * MS
