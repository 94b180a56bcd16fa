"""The board's end of sessions, by its firmware, on a clock of the test's own."""

import numpy as np
import pytest

from smarttouch.base.wire.framing import Deframer
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import (
    ACK,
    ALIVE_MS,
    LATE_MS,
    LONGEST_PACKET_MS,
    HostSession,
    Message,
    MessageKind,
    Refusal,
    decode,
)
from smarttouch.emulator.link_packets import MOST_HOSTS, BoardSession
from tests.boards.payloads import sequence_payload

from .rig import LinkRig

COLUMN = np.full(1, 100, np.uint16)
CURRENT = np.array([[300, -100, -100, -100]], np.int16)


def payload(times=1):
    return sequence_payload("weighted", 10_000, COLUMN, COLUMN, COLUMN * 0, CURRENT, times)


class Rig(LinkRig):
    """A board, the host that began its session, and all that it sent; time is `now_ms`."""

    def __init__(self):
        self.now_ms, self.sent = 0, []
        super().__init__()

    def say(self, now_ms, kind, about=0, payload=b""):
        self.sent.append(self.host.encode(kind, about, payload))
        return self.feed(now_ms, self.sent[-1])

    def tell(self, kind, about=0, payload=b""):
        return self.say(self.now_ms, kind, about, payload)

    def hear(self, data):
        return self.feed(self.now_ms, data)

    def wait(self, time_ms, beating=True):
        """Let time pass, a millisecond at once, with heartbeats that have heard the last ALIVE."""
        for _ in range(time_ms):
            self.now_ms += 1
            self.advance(self.now_ms)
            if beating and self.now_ms % 30 == 0:
                self.tell(MessageKind.HEARTBEAT)

    @property
    def counted(self):
        return self.books.old_packets, self.books.foreign_packets


@pytest.fixture
def rig():
    return Rig()


def reasons(answers):
    return [(each.kind, each.about, each.payload[:1]) for each in answers]


FOREIGN = [(MessageKind.NAK, 0, bytes([Refusal.FOREIGN]))]


def test_a_sequence_that_is_sent_again_is_acknowledged_again_and_not_delivered(rig):
    began_ms = None
    for _ in range(3):
        began_ms = rig.now_ms if began_ms is None else began_ms
        (answer,) = rig.tell(MessageKind.SEQUENCE, 1, payload())
        assert (answer.kind, answer.about) == (MessageKind.ACK, 1)
        assert ACK.unpack(answer.payload) == (1000 * began_ms,)
        rig.wait(15)
    assert (rig.books.slots, rig.counted) == (1, (0, 0))


def test_a_stop_played_again_is_harmless_and_counted(rig):
    rig.tell(MessageKind.STOP)
    stop = rig.sent[-1]
    assert rig.hear(stop) == []
    rig.begin(rig.now_ms)
    assert reasons(rig.hear(stop)) == FOREIGN
    rig.tell(MessageKind.SEQUENCE, 1, payload())
    rig.wait(5)
    assert (rig.books.slots, rig.counted) == (1, (1, 1))


def test_the_session_before_cannot_be_played_again(rig):
    rig.tell(MessageKind.SEQUENCE, 1, payload())
    rig.wait(40)
    rig.tell(MessageKind.STOP)
    before, slots = list(rig.sent), rig.books.slots
    rig.wait(10, beating=False)
    # With nobody there, and with another host there.
    for data in before:
        rig.hear(data)
    assert rig.books.slots == slots
    assert rig.counted == (len(before), 0)
    rig.begin(rig.now_ms)
    for data in before:
        assert reasons(rig.hear(data)) == FOREIGN
    rig.wait(20)
    assert (rig.books.slots, rig.counted) == (slots, (len(before), len(before)))
    # And the host that is there goes on undisturbed.
    (answer,) = rig.tell(MessageKind.SEQUENCE, 1, payload())
    assert answer.kind == MessageKind.ACK


def test_another_host_cannot_take_a_live_session_over(rig):
    rig.tell(MessageKind.SEQUENCE, 1, payload(1000))
    mine, other = rig.host, HostSession()
    assert reasons(rig.hear(other.encode(MessageKind.HELLO))) == FOREIGN
    assert reasons(rig.hear(other.encode(MessageKind.BEGIN))) == FOREIGN
    rig.wait(35)
    assert rig.host is mine
    assert (rig.books.slots, rig.books.state) == (4, "driving")
    assert rig.counted == (0, 2)


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
    assert session.foreign == 2 * MOST_HOSTS
    session.live = False
    assert hello(99, 2) is None
    assert session.old == MOST_HOSTS + 1


NOISES = ["heartbeat", "sequence", "hello", "garbage"]
NOISES += ["half a sequence", "half a stop", "half anew"]


@pytest.mark.parametrize("noise", NOISES)
def test_what_is_no_sign_of_life(rig, noise):
    """The host dies, and something on the line goes on."""
    rig.tell(MessageKind.SEQUENCE, 1, payload(10_000))
    rig.tell(MessageKind.HEARTBEAT)
    rig.wait(50)
    played = {
        "heartbeat": rig.sent[4],
        "sequence": rig.sent[3],
        "hello": rig.sent[0],
        "garbage": b"\x07garbage",
        "half a sequence": b"\0" + rig.sent[3][:-20],
        "half a stop": b"\0" + rig.host.encode(MessageKind.STOP)[:-2],
        "half anew": b"\0" + rig.host.encode(MessageKind.SEQUENCE, 2, payload())[:-2],
    }[noise]
    for _ in range(100):
        rig.wait(5, beating=False)
        rig.hear(played)
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")
    assert rig.books.zero_after_ms == pytest.approx(protocol.SILENCE_MS, abs=5)
    # The head of a sequence that never came whole is fresh for as long as that of one that does.
    fresh_ms = LATE_MS + ALIVE_MS if noise == "half anew" else 0
    assert rig.books.slots <= (50 + fresh_ms + protocol.SILENCE_MS) / 10 + 1


def test_a_long_packet_on_its_way_is_a_sign_of_life_for_a_while(rig):
    rig.tell(MessageKind.SEQUENCE, 1, payload(10_000))
    rig.wait(30)
    packet = rig.host.encode(MessageKind.SEQUENCE, 2, bytes(range(1, 251)) * 12)
    for at in range(0, LONGEST_PACKET_MS, 50):
        assert rig.books.state == "driving", at
        rig.hear(packet[at : at + 50])
        rig.wait(50, beating=False)
    # It never ends: the board does.
    for at in range(LONGEST_PACKET_MS, LONGEST_PACKET_MS + 300, 50):
        rig.hear(packet[at : at + 50])
        rig.wait(50, beating=False)
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")


def test_a_packet_of_a_host_that_has_long_received_nothing_is_old(rig):
    rig.tell(MessageKind.SEQUENCE, 1, payload(10_000))
    rig.wait(40)
    kept_back = [rig.host.encode(MessageKind.HEARTBEAT) for _ in range(20)]
    for packet in kept_back:
        # Each in turn, so that all their numbers are fresh.
        rig.wait(50, beating=False)
        rig.hear(packet)
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")
    assert rig.books.slots <= (40 + LATE_MS + ALIVE_MS + protocol.SILENCE_MS) / 10 + 1
    assert rig.counted[0] >= 14


def test_a_stop_is_never_too_late(rig, monkeypatch):
    rig.tell(MessageKind.SEQUENCE, 1, payload(10_000))
    # From here on its host hears nothing.
    monkeypatch.setattr(rig.host, "take", lambda packet: None)
    rig.wait(310)
    assert (rig.books.state, rig.counted) == ("driving", (1, 0))
    (answer,) = rig.tell(MessageKind.STOP)
    assert answer.kind == MessageKind.STOPPED
    assert (rig.books.state, rig.books.reason) == ("shorted", "stop")
