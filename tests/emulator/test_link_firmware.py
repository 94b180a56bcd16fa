"""The emulated link board on a clock of the test's own: what it keeps, hears and executes.

What it refuses is compared with the C core and a judge in ``firmware/tests``.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from firmware.tests.scenes import sequence_of
from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import BoardFaultError
from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards import link as protocol
from smarttouch.boards.link import (
    ALIVE_MS,
    LATE_MS,
    LONGEST_PACKET_MS,
    Message,
    MessageKind,
    decode,
    decode_volts,
    digest_of,
)
from smarttouch.boards.link.link_driver import LinkDriver
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.boards.link.session import LinkSession
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.link_packets import MOST_HOSTS, BoardSession
from smarttouch.emulator.link_rules import Room
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable
from tests.boards.payloads import encode_lists, limits_payload, sequence_payload

from ..support.checks import raises

MS = 1_000_000
E = 6
GOOD = [[300, -100, -100, -100], [-100, 300, -100, -100]]
"""Two pulses of 100 µs, 50 µs apart."""


class KeptBooks(DeliveryLog):
    def keep(self, number, width_us, current_ua):
        self.kept.append(np.rint(current_ua).astype(int).tolist())


class Rig:
    """A board, and a session begun at time zero, under limits."""

    def __init__(self, electrodes=4, output="weighted", **given):
        self.output, self.now_ms, self.sent = output, 0, []
        self.books = KeptBooks(electrodes)
        self.books.kept = []
        self.board = LinkFirmware(output, self.books, **{"ramp_ms": 0} | given)
        self.host = LinkSession(lambda message: None)
        said = (MessageKind.HELLO, b""), (MessageKind.BEGIN, b"")
        for kind, payload in (*said, (MessageKind.LIMITS, limits_payload(electrodes))):
            (answer,) = self.say(0, kind, payload=payload)
        assert (answer.kind, answer.payload) == (MessageKind.LIMITED, b"\1")

    def say(self, now_ms, kind, about=0, payload=b""):
        self.sent.append(self.host.encode(kind, about, payload))
        return self.feed(now_ms, self.sent[-1])

    def feed(self, now_ms, data):
        return self.taken(self.board.feed(data, round(now_ms * MS)))

    def advance(self, now_ms):
        return self.taken(self.board.advance(round(now_ms * MS)))

    def wait(self, time_ms, beating=True):
        """Let time pass, a millisecond at once, with heartbeats that have heard the last ALIVE."""
        for _ in range(time_ms):
            self.now_ms += 1
            self.advance(self.now_ms)
            if beating and self.now_ms % 30 == 0:
                self.say(self.now_ms, MessageKind.HEARTBEAT)

    def taken(self, data):
        """Return the packets in what a board says; those that no session takes are read, too."""
        self.host.take(data)
        packets = [decode(packet) for packet in Deframer().feed(data)]
        return [packet for packet in packets if packet.kind != MessageKind.ALIVE]

    def send(self, now_ms, current, **more):
        """Send a sequence."""
        current = np.asarray(current, np.int16)
        column = np.ones(len(current), np.uint16)
        payload = sequence_payload(
            self.output, 10_000, column * 100, column * 50, column, current, **more
        )
        self.say(now_ms, MessageKind.SEQUENCE, 1, payload)

    @property
    def ended(self):
        return self.books.state, self.books.reason


@pytest.fixture
def rig():
    return Rig()


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


# -- sessions ----------------------------------------------------------------


def test_hellos_that_lead_to_nothing_are_counted():
    session = BoardSession()

    def hello(half, number):
        return session.offer(Message(MessageKind.HELLO, number, half), b"")

    for half in range(1, MOST_HOSTS + 1):
        assert hello(half, 1) is not None
        assert hello(half, 2) is not None
        assert hello(half, 2) is None
    assert (session.old, session.foreign) == (MOST_HOSTS, 0)
    assert hello(99, 1) is not None
    assert session.foreign == 2 * MOST_HOSTS
    (offer,) = Deframer().feed(hello(99, 2))
    begin = Message(MessageKind.BEGIN, 3, decode(offer).session)
    assert session.would_begin(begin)
    session.begin(begin)
    session.live = False
    assert hello(99, 2) is None
    assert (session.old, session.foreign) == (MOST_HOSTS + 1, 2 * MOST_HOSTS)


@pytest.mark.parametrize("noise", ["heartbeat", "hello", "garbage", "half a stop", "half anew"])
def test_what_is_no_sign_of_life(rig, noise):
    """The host dies, and something on the line goes on."""
    rig.send(0, GOOD, times=10_000)
    rig.say(0, MessageKind.HEARTBEAT)
    rig.wait(50)
    played = {
        "heartbeat": rig.sent[4],
        "hello": rig.sent[0],
        "garbage": b"\x07garbage",
        "half a stop": b"\0" + rig.host.encode(MessageKind.STOP)[:-2],
        "half anew": b"\0" + rig.host.encode(MessageKind.SEQUENCE, 2, bytes(range(1, 60)))[:-2],
    }[noise]
    for _ in range(100):
        rig.wait(5, beating=False)
        rig.feed(rig.now_ms, played)
    assert rig.ended == ("shorted", "silence")
    assert rig.books.zero_after_ms == pytest.approx(protocol.SILENCE_MS, abs=5)
    # The head of a sequence that never came whole is fresh for as long as that of one that does.
    fresh_ms = LATE_MS + ALIVE_MS if noise == "half anew" else 0
    assert rig.books.slots <= 2 * ((50 + fresh_ms + protocol.SILENCE_MS) / 10 + 1)


def test_a_long_packet_on_its_way_is_a_sign_of_life_for_a_while(rig):
    rig.send(0, GOOD, times=10_000)
    rig.wait(30)
    packet = rig.host.encode(MessageKind.SEQUENCE, 2, bytes(range(1, 251)) * 12)
    for at in range(0, LONGEST_PACKET_MS + 300, 50):
        # It never ends: the board does.
        assert rig.books.state == "driving" or at >= LONGEST_PACKET_MS
        rig.feed(rig.now_ms, packet[at : at + 50])
        rig.wait(50, beating=False)
    assert rig.ended == ("shorted", "silence")


def test_a_stop_is_never_too_late(rig, monkeypatch):
    rig.send(0, GOOD, times=10_000)
    # From here on its host hears nothing.
    monkeypatch.setattr(rig.host, "take", lambda packet: None)
    rig.wait(310)
    assert rig.books.state == "driving"
    (answer,) = rig.say(rig.now_ms, MessageKind.STOP)
    assert answer.kind == MessageKind.STOPPED
    assert rig.ended == ("shorted", "stop")


# -- kernels -----------------------------------------------------------------


def made_table(seed=0, kernels=5):
    weights = np.random.default_rng(seed).normal(size=(kernels, E))
    weights -= weights.mean(axis=1, keepdims=True)
    weights[1, 2:] = 0
    weights[1, :2] = 1, -1
    return KernelTable.of({Afferent.RA: weights}, {})


TABLE = made_table()
LIMITS = SafetyLimits(E, 5.0, 200, 0.5, 200, 0.8, 0.5, 5.0)


@pytest.mark.parametrize(("first", "kernel", "amplitude"), [
    ([0, 1], np.array([0], np.uint16), np.array([-4000])),
    ([0, 1], np.array([0], np.uint16), np.array([4000 + 65_536])),
    ([0, 1], np.array([-5]), np.array([4000], np.uint16)),
    ([0, 1], np.array([99], np.uint16), np.array([4000], np.uint16)),
    ([0, 1], np.array([0, 0], np.uint16), np.array([3000, 1000], np.uint16)),
    ([1, 2], np.array([1, 0], np.uint16), np.array([9, 4000], np.uint16)),
    ([0, 1], np.array([0], np.uint16), np.array([3999], np.uint16)),
])  # fmt: skip
def test_lists_that_would_make_other_currents_go_as_currents(first, kernel, amplitude):
    rig, image = Rig(E, room=Room(kernel_bytes=10_000)), KernelImage.of(TABLE, 10_000, 100)
    head = protocol.KERNELS.pack(image.identity, len(image.data), 0)
    rig.say(0, MessageKind.KERNELS, payload=head + image.data)
    one, full = np.array([0], np.uint16), np.array([4000], np.uint16)
    usual = KernelLists(TABLE, np.array([0, 1]), one, full)
    sums = KernelLists(TABLE, np.array(first), kernel, amplitude)
    wanted = (sums if amplitude[0] < 0 else usual).current_ua
    sequence = sequence_of(usual, current_ua=wanted, sums=sums)
    payload = encode_lists(sequence, 1, False, False, image, 10**6)
    rig.say(0, MessageKind.SEQUENCE, 1, payload)
    rig.advance(9)
    assert rig.books.kept == wanted.tolist()


def test_a_host_takes_no_table_of_the_same_size_for_its_own():
    image, forged = (KernelImage.of(each, 10_000, 100) for each in (TABLE, made_table(seed=1)))
    for data, session in ((forged.data, 5), (image.data, 4)):
        proof = digest_of(data, session)
        kept = protocol.KEPT.pack(image.identity, len(image.data), 1, proof)
        driver = LinkDriver("x", LIMITS)
        driver.can = SimpleNamespace(kernel_bytes=10_000, most_kernels=100, packet_bytes=1000)
        driver._session = SimpleNamespace(
            name="board", number=5, ask=lambda *_, kept=kept: SimpleNamespace(payload=kept)
        )
        driver._line = SimpleNamespace(events=SimpleNamespace(fault=BoardFaultError))
        with raises(BoardFaultError, names="kernels"):
            driver.store_kernels(TABLE)
