"""The emulated board on a clock of the test's own."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import ALIVE, MessageKind, Refusal, Rule, decode_volts
from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.link_firmware import LinkFirmware

from .rig import MS, LinkRig


class Rig(LinkRig):
    def reason(self, *arguments, **options):
        for answer in self.send(*arguments, **options):
            if answer.kind == MessageKind.NAK:
                return Refusal(answer.payload[0])
        return None

    def told(self, now_ms):
        return [(answer.kind, answer.about) for answer in self.advance(now_ms)]


@pytest.fixture
def rig():
    return Rig()


GOOD = [[300, -100, -100, -100], [-100, 300, -100, -100]]


def test_what_has_begun_is_acknowledged_once(rig):
    (answer,) = rig.send(0, GOOD, number=7)
    assert (answer.kind, answer.about) == (MessageKind.ACK, 7)
    assert rig.told(5) == rig.told(11) == []


def test_slots_come_one_after_another(rig):
    assert rig.reason(0, GOOD) is None
    for now_ms, slots in ((0.149, 1), (0.151, 2), (9, 2)):
        rig.advance(now_ms)
        assert rig.books.slots == slots
    rig.advance(11)
    assert (rig.books.state, rig.books.reason) == ("shorted", "end")
    assert (rig.books.sequences, rig.books.pulses, rig.books.violations) == (1, 8, 0)
    assert rig.books.max_current_ma == pytest.approx(0.3)
    assert rig.books.max_charge_uc == pytest.approx(0.03)


def test_one_executes_one_waits_a_third_is_busy(rig):
    assert rig.reason(0, GOOD, number=1) is None
    assert rig.reason(1, GOOD, number=2) is None
    assert rig.reason(2, GOOD, number=3) is Refusal.BUSY
    assert rig.told(9.99) == []
    assert rig.books.slots == 2
    assert rig.told(10.01) == [(MessageKind.ACK, 2)]
    assert rig.books.slots == 3
    assert rig.reason(10.5, GOOD, number=4) is None


def test_stop_is_at_once_and_lasts_until_begin(rig):
    rig.send(0, GOOD)
    rig.send(0, GOOD)
    (answer,) = rig.say(0.1, MessageKind.STOP)
    assert answer.kind == MessageKind.STOPPED
    rig.advance(90)
    assert (rig.books.state, rig.books.reason, rig.books.slots) == ("shorted", "stop", 1)
    assert rig.reason(90, GOOD) is Refusal.STOPPED
    rig.begin(91)
    assert rig.reason(92, GOOD) is None


def test_begin_ends_what_a_host_before_left(rig):
    rig.send(0, GOOD)
    rig.send(0, GOOD, number=2)
    rig.board.hang_up(int(0.1 * MS))
    rig.begin(0.1)
    rig.advance(90)
    assert (rig.books.state, rig.books.slots) == ("shorted", 1)


def test_silence_shorts_everything(rig):
    long = np.tile(GOOD, (500, 1))
    rig.send(0, long, period=200_000)
    rig.send(1, GOOD, number=2)
    rig.advance(99)
    assert rig.books.state == "driving"
    assert rig.told(103) == [(MessageKind.NAK, 2)]
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")
    assert rig.books.zero_after_ms == pytest.approx(102)
    delivered = rig.books.slots
    # Nothing that was due after the board fell silent has flowed.
    assert delivered <= 101 / 0.15 + 1
    rig.advance(400)
    assert rig.books.slots == delivered


def test_after_a_silence_only_begin_helps(rig):
    rig.advance(101)
    assert rig.reason(102, GOOD) is Refusal.SILENCE
    assert rig.reason(103, GOOD) is Refusal.SILENCE
    rig.begin(104)
    assert rig.reason(105, GOOD) is None


def test_heartbeats_keep_it_alive_and_it_sends_unasked(rig):
    rig.send(0, np.tile(GOOD, (500, 1)), period=200_000)
    for now_ms in range(5, 201, 5):
        assert rig.told(now_ms) == []
        if now_ms % 40 == 0:
            assert rig.say(now_ms, MessageKind.HEARTBEAT) == []
    assert rig.books.slots == 1000
    assert len(rig.alive) == 10
    assert ALIVE.unpack(rig.alive[-1].payload) == (round(1000 * EmulatedFinger(4).force_n),)


def test_a_sequence_is_repeated_as_often_as_asked(rig):
    rig.send(0, GOOD, times=3)
    assert rig.told(29.9) == []
    assert rig.books.slots == 6
    rig.advance(50)
    assert (rig.books.slots, rig.books.sequences) == (6, 1)
    assert (rig.books.state, rig.books.reason) == ("shorted", "end")


def test_a_new_table_waits_for_the_end_of_the_scan_and_ends_the_repetition(rig):
    rig.send(0, GOOD, times=100)
    assert rig.reason(10.1, GOOD[:1], number=2) is None
    assert rig.books.slots == 3
    # The scan at hand is finished first: none is ever torn.
    assert rig.told(19.9) == []
    assert rig.books.slots == 4
    assert rig.told(20.1) == [(MessageKind.ACK, 2)]
    assert rig.books.slots == 5
    rig.advance(60)
    assert rig.books.slots == 5


def test_the_same_number_is_the_same_sequence(rig):
    rig.send(0, GOOD, number=7)
    (again,) = rig.send(1, GOOD, number=7)
    assert (again.kind, again.about) == (MessageKind.ACK, 7)
    assert rig.send(2, GOOD, number=8) == []
    # Not begun yet: it waits, and is neither taken twice nor refused as a third.
    assert rig.send(3, GOOD, number=8) == []
    assert rig.told(10.1) == [(MessageKind.ACK, 8)]
    rig.advance(40)
    assert rig.books.slots == 4
    rig.say(50, MessageKind.STOP)
    rig.begin(50)
    (fresh,) = rig.send(51, GOOD, number=8)
    assert fresh.kind == MessageKind.ACK
    assert rig.books.slots == 5


def test_garbled_bytes_are_reported(rig):
    (answer,) = rig.feed(1, b"\x05abcd\0")
    assert (answer.kind, answer.about, answer.payload[0]) == (MessageKind.NAK, 0, Refusal.GARBLED)


def test_hello_of_any_version_is_answered_and_nothing_else():
    board = LinkFirmware(4, "weighted", DeliveryLog(4))
    (answer,) = Deframer().feed(board.feed(frame_packet(9, MessageKind.HELLO, 0, b""), 0))
    assert (answer.kind, answer.version) == (MessageKind.CAPABILITIES, protocol.VERSION)
    assert board.feed(frame_packet(9, MessageKind.STATUS, 1, bytes(16)), MS) == b""
    assert board.books.foreign_packets == 1


@pytest.mark.parametrize("output", protocol.OUTPUTS)
def test_voltages_are_reported_after_each_scan(output):
    rig = Rig(output=output)
    rig.send(0, GOOD, times=2, measure=True)
    told = [*rig.advance(11), *rig.advance(21)]
    assert [packet.kind for packet in told] == [MessageKind.VOLTAGES] * 2
    volts = decode_volts(told[0].payload)
    # 0.3 mA through 52 kOhm that 0.1 ms is long enough for, and a third of that on the way back.
    assert volts == pytest.approx([20, 20], rel=0.25)


def test_an_open_electrode_needs_all_the_voltage_there_is():
    rig = Rig(output="one-against-all", finger=EmulatedFinger(4, ["0 open 1"]))
    rig.send(0, GOOD, measure=True)
    (told,) = rig.advance(11)
    assert decode_volts(told.payload)[1] == pytest.approx(300, abs=0.02)
    assert decode_volts(told.payload)[0] < 60


@pytest.mark.parametrize(("output", "current", "options"), [
    ("weighted", [[300, -100, -100, -99]], {}),
    ("weighted", [[5001, -5001, 0, 0]], {"width": 20}),
    ("weighted", [[-32768, 32767, 1, 0]], {"width": 1}),
    ("weighted", [[100, -100, 0, 0]], {"width": 201}),
    ("weighted", [[100, -100, 0, 0]], {"width": 0}),
    ("weighted", [[5000, -5000, 0, 0]], {"width": 101}),
    ("weighted", GOOD, {"period": 299}),
    ("weighted", GOOD, {"period": 0}),
    ("three-state", [[100, 0, 0, 0]], {}),
    ("three-state", [[-100, 0, 0, 0]], {}),
    ("three-state", [[0, 0, 0, 0]], {}),
    ("three-state", [[5001, -2500, -2501, 0]], {"width": 20}),
    ("one-against-all", [[100, -100, 0, 0]], {}),
    ("one-against-all", [[100, 100, -100, -100]], {}),
])  # fmt: skip
def test_unsafe_is_refused_counted_and_never_executed(output, current, options):
    rig = Rig(output=output)
    assert rig.reason(0, current, **options) is Refusal.UNSAFE
    rig.advance(50)
    assert (rig.books.violations, rig.books.slots, rig.books.state) == (1, 0, "shorted")


def test_an_unknown_state_is_refused():
    rig = Rig(output="three-state")
    head = struct.pack("<IHHBBHH", 10_000, 1, 0xFFFF, 0, 1, 100, 50)
    payload = head + struct.pack("<BBHHHB", 3, 0, 1, 0, 100, 0b00_11_10_01)
    (answer,) = rig.say(0, MessageKind.SEQUENCE, 5, payload)
    assert protocol.NAK.unpack(answer.payload)[:2] == (Refusal.UNSAFE, Rule.STATES)
    assert rig.books.slots == 0


@pytest.mark.parametrize("output", ["weighted", "three-state"])
def test_a_sequence_for_another_board_is_refused(output):
    rig = Rig(output=output)
    other = {"weighted": "three-state", "three-state": "weighted"}[output]
    assert rig.reason(0, GOOD, output=other) in (Refusal.UNSAFE, Refusal.MALFORMED)
    assert rig.reason(0, [[1, -1, 0, 0, 0]]) in (Refusal.UNSAFE, Refusal.MALFORMED)
    assert rig.books.slots == 0


@pytest.mark.parametrize("output", protocol.OUTPUTS)
def test_a_sequence_without_slots_is_executed(output):
    rig = Rig(output=output)
    assert rig.reason(0, np.empty((0, 4))) is None
    rig.advance(20)
    assert (rig.books.sequences, rig.books.slots, rig.books.violations) == (1, 0, 0)


def test_nothing_before_a_session():
    rig = Rig(begun=False)
    assert rig.send(0, GOOD) == []
    rig.say(1, MessageKind.HELLO)
    assert rig.send(2, GOOD) == []
    assert (rig.books.slots, rig.books.foreign_packets) == (0, 2)


@given(pieces=st.lists(st.binary(max_size=50)))
def test_any_bytes_are_survived_and_nothing_is_delivered(pieces):
    rig = Rig()
    for step, piece in enumerate(pieces):
        rig.board.feed(piece, step * MS)
    rig.advance(len(pieces))
    assert rig.books.slots == 0


@given(payload=st.binary(max_size=80))
def test_any_payload_is_answered_and_never_breaks_a_ceiling(payload):
    rig = Rig()
    (answer,) = rig.say(0, MessageKind.SEQUENCE, 1, payload)
    assert answer.kind in (MessageKind.ACK, MessageKind.NAK)
    rig.advance(20)
    assert rig.books.max_current_ma <= 5
    assert rig.books.max_charge_uc <= 0.5


def test_one_source_divides_by_impedance():
    rig = Rig(output="three-state")
    rig.send(0, [[450, 150, -400, -200]])
    rig.advance(20)
    # Equal shares would be 0.3 mA; electrodes differ by up to 15 %.
    assert rig.books.max_current_ma == pytest.approx(0.3, rel=0.15)
    assert rig.books.max_current_ma != pytest.approx(0.3, rel=1e-3)
    assert rig.books.pulses == 4
