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
SESSION, OTHER = UPPER << 32 | LOWER, 7 << 32 | LOWER
ACK, ALIVE, REPORT = MessageKind.ACK, MessageKind.ALIVE, MessageKind.REPORT
CAPABILITIES, BEGUN, STOPPED = MessageKind.CAPABILITIES, MessageKind.BEGUN, MessageKind.STOPPED
HELLO = [(MessageKind.HELLO, LOWER)]
BEGIN = [*HELLO, (CAPABILITIES, 1, SESSION, 0, True), (MessageKind.BEGIN, SESSION)]
BEGUN_NOW = [*BEGIN, (BEGUN, 2, SESSION, 1, True)]


def play(steps, version=VERSION):
    """Play what a host asks, (kind, its session), and a board says, (kind, about, session, number,
    whether it is taken); return the session."""
    session = HostSession(lambda: LOWER)
    for kind, *step in steps:
        if len(step) == 1:
            (packet,) = Deframer().feed(session.encode(kind, 7, b"same"))
            asked = decode(packet)
            assert (asked.kind, asked.session) == (kind, *step)
            assert (asked.number, asked.about, asked.payload) == (session.sent, 7, b"same")
        else:
            about, of, number, taken = step
            (packet,) = Deframer().feed(encode(kind, of, number, 0, about))
            assert (session.take(packet) is not None) == taken, (kind, *step)
    return session


@pytest.mark.parametrize(("steps", "refused"), [
    (BEGUN_NOW, 0),
    # What is old.
    ([*BEGUN_NOW, (ALIVE, 0, SESSION, 5, True), *((ALIVE, 0, SESSION, number, False)
      for number in (5, 4, 1, 0)), (ALIVE, 0, SESSION, 6, True)], 4),
    # What is of another session.
    *(([*BEGUN_NOW, *((kind, 1, session, 9, False)
        for kind in (ACK, ALIVE, MessageKind.VOLTAGES, STOPPED, BEGUN, CAPABILITIES))], 6)
      for session in (0, 1, LOWER, UPPER << 32, SESSION + 1, SESSION ^ 1 << 63)),
    # Capabilities for another host; of a board nothing is known yet, so they do not count.
    ([*HELLO, (CAPABILITIES, 1, UPPER << 32 | 99, 0, False), (CAPABILITIES, 1, SESSION, 0, True)],
     0),
    # An answer is taken once, and only if asked, even if it comes late.
    ([*BEGUN_NOW, (MessageKind.STATUS, SESSION), (MessageKind.STATUS, SESSION),
      (REPORT, 4, SESSION, 2, True), (REPORT, 4, SESSION, 3, False), (REPORT, 3, SESSION, 4, True),
      (REPORT, 99, SESSION, 5, False), (MessageKind.STATUS, SESSION),
      (STOPPED, 5, SESSION, 6, False)], 3),
    # A late answer to an earlier HELLO changes nothing; both may come.
    ([*HELLO, *HELLO, (CAPABILITIES, 2, SESSION, 0, True), (CAPABILITIES, 1, OTHER, 0, False),
      (MessageKind.BEGIN, SESSION)], 1),
    ([*HELLO, *HELLO, (CAPABILITIES, 1, SESSION, 0, True), (MessageKind.BEGIN, SESSION),
      (BEGUN, 3, SESSION, 1, True), (CAPABILITIES, 2, SESSION, 0, True)], 0),
])  # fmt: skip
def test_what_is_taken_and_what_is_counted(steps, refused):
    session = play(steps)
    assert session.refused == refused
    assert session.begun == any(step[0] == BEGUN and step[-1] for step in steps)


def test_a_packet_confirms_the_last_one_that_was_taken():
    session = play([*BEGUN_NOW, (ALIVE, 0, SESSION, 5, True), (ALIVE, 0, SESSION, 4, False)])
    (packet,) = Deframer().feed(session.encode(MessageKind.HEARTBEAT))
    assert decode(packet).heard == 5


@pytest.mark.parametrize(("steps", "taken"), [(HELLO, True), (BEGUN_NOW, False)])
def test_another_version_is_taken_before_a_session_alone(steps, taken):
    session = play(steps)
    (packet,) = Deframer().feed(encode(CAPABILITIES, SESSION, 9, 0, 1))
    message = session.take(type(packet)(packet.kind, packet.number, packet.payload, 2))
    assert (message is not None and message.version == 2) == taken


def test_when_numbers_run_out_another_session_is_needed(monkeypatch):
    monkeypatch.setattr(protocol, "LAST_NUMBER", 2)
    with raises(LineLostError, names="packets", allowed=2):
        play(BEGUN_NOW).encode(MessageKind.HEARTBEAT)


def test_halves_are_random_and_never_zero(monkeypatch):
    drawn = {draw_half() for _ in range(1000)}
    assert len(drawn) > 990
    assert all(0 < each <= HALF for each in drawn)
    for given, half in ((HALF - 1, HALF), (0, 1)):
        monkeypatch.setattr(protocol.secrets, "randbelow", lambda _, given=given: given)
        assert draw_half() == half
