"""Messages are decoded as they were encoded, and no bytes can hurt a receiver."""

import itertools
import struct
import zlib

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from smarttouch.base.errors import BoardError
from smarttouch.base.wire.framing import LARGEST_PACKET, Deframer, WirePacket
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import (
    WHOLE_HEAD_BYTES,
    MessageKind,
    decode,
    decode_head,
    decode_volts,
    encode,
    encode_volts,
)
from smarttouch.boards.link.sequence_encoding import encode_scan
from smarttouch.emulator.link_packets import decode_lists
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..raising import raises
from .payloads import sequence_payload

u16 = st.integers(0, 65535)
currents = hnp.arrays(
    np.int16, st.tuples(st.integers(0, 6), st.integers(1, 11)), elements=st.integers(-5000, 5000)
)


def only(packets):
    (packet,) = packets
    return packet


def decode_sequence(payload, electrodes, output="weighted"):
    return decode_lists(payload, electrodes, output != "weighted")


def columns(current, seed=0):
    slots = len(current)
    random = np.random.default_rng(seed)
    return [random.integers(0, 65536, slots).astype(np.uint16) for _ in range(3)]


@pytest.mark.parametrize("output", ["three-state", "one-against-all"])
@given(current=currents)
def test_switched_survives_the_wire(output, current):
    payload = sequence_payload(output, 9000, *columns(current), current)
    wire = decode_sequence(payload, current.shape[1], output)
    np.testing.assert_array_equal(wire.rows, np.sign(current))
    np.testing.assert_array_equal(wire.source_ua, np.maximum(current, 0).sum(axis=1))


def test_a_source_beyond_the_wire_is_refused_and_never_wraps():
    current = np.array([[5000] * 14 + [-5000] * 14], np.int16)
    with raises(BoardError, value=70.0, allowed=65.5, slot=0):
        sequence_payload("three-state", 9000, *columns(current), current)


@pytest.mark.parametrize(("slots", "electrodes", "room", "attributes"), [
    (600, 1024, (2000, 1 << 16), {"allowed": 2000}),
    (70_000, 1, (1 << 20, 70_000), {"names": "slots", "value": 70_000, "allowed": 65_535}),
])  # fmt: skip
def test_a_slot_beyond_the_room_of_a_packet_is_refused(slots, electrodes, room, attributes):
    column = np.full(slots, 100, np.uint16)
    current = np.zeros((slots, electrodes), np.int16)
    sequence = ScanSequence(current, column, column, 0 * column, 9000, 1.0, 0)
    with raises(BoardError, **attributes):
        encode_scan(sequence, 1, False, False, None, *room)


@given(pieces=st.lists(st.binary(max_size=60)))
def test_any_bytes_are_survived_and_the_next_packet_is_found(pieces):
    deframer = Deframer()
    for piece in pieces:
        list(deframer.feed(piece))
    packets = list(deframer.feed(b"\0" + encode(MessageKind.STOP, 1, 3)))
    assert (packets[-1].kind, packets[-1].number) == (MessageKind.STOP, 3)


@given(position=st.integers(0, 40), flip=st.integers(1, 255))
def test_a_changed_byte_is_an_error_and_no_packet(position, flip):
    data = bytearray(encode(MessageKind.SEQUENCE, 1, 9, payload=bytes(range(1, 31))))
    data[position % (len(data) - 1)] ^= flip
    deframer = Deframer()
    assert list(deframer.feed(bytes(data))) == []
    list(deframer.feed(b"\0"))
    assert deframer.errors >= 1


def test_an_endless_packet_does_not_fill_the_memory():
    deframer = Deframer()
    for _ in range(12):
        list(deframer.feed(b"\x01" * 2**20))
    assert len(deframer._waiting) <= LARGEST_PACKET * 1.1
    assert list(deframer.feed(b"\0")) == []
    assert len(list(deframer.feed(encode(MessageKind.STOP, 1, 1)))) == 1


@given(hnp.arrays(np.float64, st.integers(0, 50), elements=st.floats(0, 655)))
def test_voltages_survive_the_wire(volts):
    np.testing.assert_allclose(decode_volts(encode_volts(volts)), volts, atol=0.006)


@given(current=currents, seed=st.integers(0, 9), width_us=st.integers(0, 65535))
def test_a_recharge_phase_survives_the_wire(current, seed, width_us):
    recharge = np.random.default_rng(seed).integers(-500, 501, current.shape[1]).astype(np.int16)
    payload = sequence_payload(
        "weighted", 9000, *columns(current), current, 2, True, recharge, width_us
    )
    wire = decode_sequence(payload, current.shape[1])
    assert (wire.measure, wire.times, wire.recharge_us) == (True, 2, width_us)
    np.testing.assert_array_equal(wire.recharge_ua, recharge)
    np.testing.assert_array_equal(wire.rows, current)
    for wrong in (payload[:-1], payload + b"\0", payload[: -2 * current.shape[1]]):
        with pytest.raises(ValueError):
            decode_sequence(wrong, current.shape[1])


@given(current=currents, seed=st.integers(0, 9), shapes=st.integers(1, 3), measure=st.booleans())
def test_the_bytes_are_those_of_a_plain_encoder(current, seed, shapes, measure):
    _, _, site = columns(current, seed)
    shape = np.random.default_rng(seed).integers(0, shapes, len(current)).tolist()
    # Shapes 0 and 1 differ by their rest alone.
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
    packet = encode(MessageKind.SEQUENCE, 5, 7, 6, 4, plain)
    assert cobs.decode(packet[:-1]) == body + struct.pack("<I", zlib.crc32(body))


def test_one_source_makes_no_recharge_phase():
    current = np.array([[300, -300]], np.int16)
    with pytest.raises(BoardError):
        sequence_payload("three-state", 9000, *columns(current), current, 1, False, current[0], 9)
    payload = bytearray(sequence_payload("three-state", 9000, *columns(current), current))
    payload[8] |= 2
    with pytest.raises(ValueError):
        decode_sequence(bytes(payload), 2, "three-state")


def test_no_times_at_all_is_no_sequence():
    current = np.zeros((1, 4), np.int16)
    payload = sequence_payload("weighted", 9000, *columns(current), current, 0)
    assert decode_sequence(sequence_payload("weighted", 9000, *columns(current), current, 1), 4)
    with pytest.raises(ValueError):
        decode_sequence(payload, 4)


@given(payload=st.binary(max_size=600), cut=st.integers(0, 700), session=st.integers(0, 2**64 - 1))
def test_the_head_of_a_packet_is_known_before_its_end(payload, cut, session):
    data = encode(MessageKind.SEQUENCE, session, 258, 0, 7, payload)
    deframer = Deframer()
    list(deframer.feed(data[: min(cut, len(data) - 1)]))
    assert deframer.waiting == min(cut, len(data) - 1)
    head = deframer.head(WHOLE_HEAD_BYTES)
    if head is None:
        assert cut <= WHOLE_HEAD_BYTES
    else:
        message = decode_head(head)
        assert (message.kind, message.session) == (MessageKind.SEQUENCE, session)
        assert (message.number, message.heard, message.about) == (258, 0, 7)


def test_what_is_too_short_belongs_to_no_session():
    for length in range(16):
        message = decode(WirePacket(MessageKind.STOP, 9, bytes([1] * length), protocol.VERSION))
        assert (message.session, message.payload) == (0, b"")
