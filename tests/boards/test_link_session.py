"""The host's end of a session: what it numbers, what it takes, and what it counts."""

import pytest

from smarttouch.base.errors import LineLostError
from smarttouch.base.wire.framing import Deframer
from smarttouch.boards.link import protocol
from smarttouch.boards.link.protocol import (
    HALF,
    VERSION,
    HostSession,
    MessageKind,
    decode,
    draw_half,
    encode,
)

from ..raising import raises

LOWER, UPPER = 0x1234, 0xABCD
SESSION = UPPER << 32 | LOWER


def message(data):
    (packet,) = Deframer().feed(data)
    return decode(packet)


class Talk:
    """A session and what a board says to it."""

    def __init__(self):
        self.session = HostSession(lambda: LOWER)
        self.said = 0

    def ask(self, kind):
        return message(self.session.encode(kind)).number

    def hear(self, kind, about=0, session=SESSION, number=None, version=VERSION):
        self.said = self.said + 1 if number is None else number
        (packet,) = Deframer().feed(encode(kind, session, self.said, 0, about))
        if version != VERSION:
            packet = type(packet)(packet.kind, packet.number, packet.payload, version)
        return self.session.take(packet)

    def begin(self):
        self.hear(MessageKind.CAPABILITIES, self.ask(MessageKind.HELLO), number=0)
        assert self.hear(MessageKind.BEGUN, self.ask(MessageKind.BEGIN), number=1) is not None
        return self


@pytest.fixture
def talk():
    return Talk().begin()


def test_hello_bears_the_hosts_half_and_begin_both():
    talk = Talk()
    hello = message(talk.session.encode(MessageKind.HELLO))
    assert (hello.session, hello.number, hello.heard) == (LOWER, 1, 0)
    assert talk.hear(MessageKind.CAPABILITIES, 1, number=0) is not None
    begin = message(talk.session.encode(MessageKind.BEGIN))
    assert (begin.session, begin.number) == (SESSION, 2)
    assert not talk.session.begun
    assert talk.hear(MessageKind.BEGUN, 2, number=1) is not None
    assert talk.session.begun
    assert talk.session.refused == 0


def test_numbers_rise_and_confirm_what_was_received(talk):
    talk.hear(MessageKind.ALIVE)
    sent = [message(talk.session.encode(MessageKind.HEARTBEAT)) for _ in range(3)]
    assert [each.number for each in sent] == [3, 4, 5]
    assert {each.heard for each in sent} == {2}
    assert {each.session for each in sent} == {SESSION}
    again = message(talk.session.encode(MessageKind.SEQUENCE, 7, b"same"))
    assert (again.number, again.about, again.payload) == (6, 7, b"same")


def test_what_is_old_is_refused_and_counted(talk):
    assert talk.hear(MessageKind.ALIVE, number=5) is not None
    for count, number in enumerate((5, 4, 1, 0), start=1):
        assert talk.hear(MessageKind.ALIVE, number=number) is None
        assert talk.session.refused == count
    assert talk.hear(MessageKind.ALIVE, number=6) is not None


@pytest.mark.parametrize("session", [0, 1, LOWER, UPPER << 32, SESSION + 1, SESSION ^ 1 << 63])
def test_what_is_of_another_session_is_refused_and_counted(talk, session):
    for kind in (
        MessageKind.ACK,
        MessageKind.ALIVE,
        MessageKind.VOLTAGES,
        MessageKind.STOPPED,
        MessageKind.BEGUN,
        MessageKind.CAPABILITIES,
    ):
        assert talk.hear(kind, 1, session) is None
    assert talk.session.refused == 6


def test_another_version_is_refused_once_a_session_has_begun():
    talk = Talk()
    early = talk.hear(MessageKind.CAPABILITIES, version=2)
    assert (early.kind, early.version) == (MessageKind.CAPABILITIES, 2)
    talk.begin()
    assert talk.hear(MessageKind.CAPABILITIES, version=2) is None
    assert talk.hear(MessageKind.ACK, version=2) is None
    assert talk.session.refused == 2


def test_capabilities_for_another_host_are_not_taken():
    talk = Talk()
    hello = talk.ask(MessageKind.HELLO)
    assert talk.hear(MessageKind.CAPABILITIES, hello, UPPER << 32 | 99, number=0) is None
    # Nothing is known of a board yet: what comes now may be of the run before.
    assert talk.session.refused == 0
    assert talk.hear(MessageKind.CAPABILITIES, hello, number=0) is not None


def test_an_answer_is_taken_once_and_only_if_asked(talk):
    first, second = talk.ask(MessageKind.STATUS), talk.ask(MessageKind.STATUS)
    assert talk.hear(MessageKind.REPORT, second) is not None
    assert talk.hear(MessageKind.REPORT, second) is None
    # Late, but asked, and not answered before.
    assert talk.hear(MessageKind.REPORT, first) is not None
    assert talk.hear(MessageKind.REPORT, 99) is None
    assert talk.hear(MessageKind.STOPPED, talk.ask(MessageKind.STATUS)) is None
    assert talk.session.refused == 3


def test_a_late_answer_to_an_earlier_hello_changes_nothing():
    talk = Talk()
    first, second = talk.ask(MessageKind.HELLO), talk.ask(MessageKind.HELLO)
    assert talk.hear(MessageKind.CAPABILITIES, second, number=0) is not None
    other = 7 << 32 | LOWER
    assert talk.hear(MessageKind.CAPABILITIES, first, other, number=0) is None
    assert talk.session.number == SESSION


def test_both_answers_to_two_hellos_may_come():
    talk = Talk()
    first, second = talk.ask(MessageKind.HELLO), talk.ask(MessageKind.HELLO)
    assert talk.hear(MessageKind.CAPABILITIES, first, number=0) is not None
    assert talk.hear(MessageKind.BEGUN, talk.ask(MessageKind.BEGIN), number=1) is not None
    assert talk.hear(MessageKind.CAPABILITIES, second, number=0) is not None
    assert talk.session.refused == 0


def test_when_numbers_run_out_another_session_is_needed(monkeypatch):
    monkeypatch.setattr(protocol, "LAST_NUMBER", 4)
    talk = Talk().begin()
    talk.session.encode(MessageKind.HEARTBEAT)
    talk.session.encode(MessageKind.HEARTBEAT)
    with raises(LineLostError, names="packets", allowed=4):
        talk.session.encode(MessageKind.HEARTBEAT)


def test_halves_are_random_and_never_zero(monkeypatch):
    drawn = {draw_half() for _ in range(1000)}
    assert len(drawn) > 990
    assert all(0 < each <= HALF for each in drawn)
    monkeypatch.setattr(protocol.secrets, "randbelow", lambda limit: limit - 1)
    assert draw_half() == HALF
    monkeypatch.setattr(protocol.secrets, "randbelow", lambda limit: 0)
    assert draw_half() == 1
