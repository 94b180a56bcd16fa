"""The emulated board on a clock of the test's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import MessageKind, Refusal, decode_volts
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


def test_hello_of_any_version_is_answered_and_nothing_else():
    board = LinkFirmware("weighted", DeliveryLog(4))
    (answer,) = Deframer().feed(board.feed(frame_packet(9, MessageKind.HELLO, 0, b""), 0))
    assert (answer.kind, answer.version) == (MessageKind.CAPABILITIES, protocol.VERSION)
    assert board.feed(frame_packet(9, MessageKind.STATUS, 1, bytes(16)), MS) == b""
    assert board.books.foreign_packets == 1


def test_an_open_electrode_needs_all_the_voltage_there_is():
    rig = Rig(output="one-against-all", finger=EmulatedFinger(4, ["0 open 1"]))
    rig.send(0, GOOD, measure=True)
    (told,) = rig.advance(11)
    assert decode_volts(told.payload)[1] == pytest.approx(300, abs=0.02)
    assert decode_volts(told.payload)[0] < 60


@pytest.mark.parametrize(("output", "current", "options"), [
    ("weighted", [[-32768, 32767, 1, 0]], {"width": 1}),
    ("weighted", [[100, -100, 0, 0]], {"width": 0}),
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
