"""The emulated board on a clock of the test's own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards import protocol
from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.firmware import Firmware
from smarttouch.boards.emulator.skin import Skin
from smarttouch.boards.protocol import Deframer, Kind, Refusal

MS = 1_000_000


class Rig:
    """A board that was said HELLO to, at time zero."""

    def __init__(self, electrodes=4, output="weighted", hello=True):
        self.output = output
        self.books = Books(electrodes)
        self.board = Firmware(electrodes, output, self.books)
        if hello:
            self.say(0, Kind.HELLO)

    def say(self, now_ms, kind, number=0, payload=b""):
        return self.feed(now_ms, protocol.encode(kind, number, payload))

    def feed(self, now_ms, data):
        return list(Deframer().feed(self.board.feed(data, int(now_ms * MS))))

    def send(self, now_ms, current, *, number=1, width=100, discharge=50, period=10_000, output=""):
        current = np.asarray(current, np.int16)
        column = np.ones(len(current), np.uint16)
        data = protocol.encode_sequence(
            number, output or self.output, period, column * width, column * discharge,
            column, current,
        )  # fmt: skip
        return self.feed(now_ms, data)

    def reason(self, *arguments, **options):
        for answer in self.send(*arguments, **options):
            if answer.kind == Kind.NAK:
                return Refusal(answer.payload[0])
        return None

    def advance(self, now_ms):
        answers = Deframer().feed(self.board.advance(int(now_ms * MS)))
        return [(answer.kind, answer.number) for answer in answers]


GOOD = [[300, -100, -100, -100], [-100, 300, -100, -100]]


def test_what_has_begun_is_acknowledged_once():
    rig = Rig()
    (answer,) = rig.send(0, GOOD, number=7)
    assert (answer.kind, answer.number) == (Kind.ACK, 7)
    assert rig.advance(5) == rig.advance(11) == []


def test_slots_come_one_after_another():
    rig = Rig()
    assert rig.reason(0, GOOD) is None
    for now_ms, slots in ((0.149, 1), (0.151, 2), (9, 2)):
        rig.board.advance(int(now_ms * MS))
        assert rig.books.slots == slots
    rig.board.advance(11 * MS)
    assert (rig.books.state, rig.books.reason) == ("shorted", "end")
    assert (rig.books.sequences, rig.books.pulses, rig.books.violations) == (1, 8, 0)
    assert rig.books.max_current_ma == pytest.approx(0.3)
    assert rig.books.max_charge_uc == pytest.approx(0.03)


def test_one_executes_one_waits_a_third_is_busy():
    rig = Rig()
    assert rig.reason(0, GOOD, number=1) is None
    assert rig.reason(1, GOOD, number=2) is None
    assert rig.reason(2, GOOD, number=3) is Refusal.BUSY
    assert rig.advance(9.99) == []
    assert rig.books.slots == 2
    assert rig.advance(10.01) == [(Kind.ACK, 2)]
    assert rig.books.slots == 3
    assert rig.reason(10.5, GOOD, number=4) is None


def test_stop_is_at_once_and_lasts_until_hello():
    rig = Rig()
    rig.send(0, GOOD)
    rig.send(0, GOOD)
    (answer,) = rig.say(0.1, Kind.STOP)
    assert answer.kind == Kind.STOPPED
    rig.board.advance(90 * MS)
    assert (rig.books.state, rig.books.reason, rig.books.slots) == ("shorted", "stop", 1)
    assert rig.reason(90, GOOD) is Refusal.STOPPED
    rig.say(91, Kind.HELLO)
    assert rig.reason(92, GOOD) is None


def test_hello_ends_what_a_host_before_left():
    rig = Rig()
    rig.send(0, GOOD)
    rig.send(0, GOOD, number=2)
    rig.say(0.1, Kind.HELLO)
    rig.board.advance(90 * MS)
    assert (rig.books.state, rig.books.slots) == ("shorted", 1)


def test_silence_shorts_everything():
    rig = Rig()
    long = np.tile(GOOD, (500, 1))
    rig.send(0, long, period=200_000)
    rig.send(1, GOOD, number=2)
    rig.board.advance(99 * MS)
    assert rig.books.state == "driving"
    assert rig.advance(103) == [(Kind.NAK, 2)]
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")
    assert rig.books.zero_after_ms == pytest.approx(102)
    delivered = rig.books.slots
    # Nothing that was due after the board fell silent has flowed.
    assert delivered <= 101 / 0.15 + 1
    rig.board.advance(400 * MS)
    assert rig.books.slots == delivered


def test_heartbeats_keep_it_alive():
    rig = Rig()
    rig.send(0, np.tile(GOOD, (500, 1)), period=200_000)
    for now_ms in range(40, 201, 40):
        (answer,) = rig.say(now_ms, Kind.HEARTBEAT)
        assert answer.kind == Kind.ALIVE
    assert rig.books.slots == 1000


@pytest.mark.parametrize(
    ("output", "current", "options"),
    [
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
    ],
)
def test_unsafe_is_refused_counted_and_never_executed(output, current, options):
    rig = Rig(output=output)
    assert rig.reason(0, current, **options) is Refusal.UNSAFE
    rig.board.advance(50 * MS)
    assert (rig.books.violations, rig.books.slots, rig.books.state) == (1, 0, "shorted")


def test_an_unknown_state_is_refused():
    rig = Rig(output="three-state")
    payload = protocol._SEQUENCE.pack(10_000, 1, 4, 1) + bytes(
        [100, 0, 50, 0, 0, 0, 100, 0, 0b00_11_10_01]
    )
    (answer,) = rig.say(0, Kind.SEQUENCE, 5, payload)
    assert (answer.kind, answer.payload[0]) == (Kind.NAK, Refusal.UNSAFE)
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
    rig.board.advance(20 * MS)
    assert (rig.books.sequences, rig.books.slots, rig.books.violations) == (1, 0, 0)


def test_nothing_before_hello():
    rig = Rig(hello=False)
    assert rig.reason(0, GOOD) is Refusal.STOPPED
    assert rig.books.slots == 0


@given(pieces=st.lists(st.binary(max_size=50)))
def test_any_bytes_are_survived_and_nothing_is_delivered(pieces):
    rig = Rig()
    for step, piece in enumerate(pieces):
        rig.board.feed(piece, step * MS)
    rig.board.advance(len(pieces) * MS)
    assert rig.books.slots == 0


@given(payload=st.binary(max_size=80))
def test_any_payload_is_answered_and_never_breaks_a_ceiling(payload):
    rig = Rig()
    (answer,) = rig.say(0, Kind.SEQUENCE, 1, payload)
    assert answer.kind in (Kind.ACK, Kind.NAK)
    rig.board.advance(20 * MS)
    assert rig.books.max_current_ma <= 5
    assert rig.books.max_charge_uc <= 0.5


def test_one_source_divides_equally():
    rig = Rig(output="three-state")
    rig.send(0, [[450, 150, -400, -200]])
    rig.board.advance(20 * MS)
    assert rig.books.max_current_ma == pytest.approx(0.3)
    assert rig.books.pulses == 4


def test_a_short_circuit_lets_charge_out_with_rc():
    skin = Skin(4)
    skin.pulse(np.array([300.0, -100, -100, -100]), 100)
    assert skin.worst_uc == pytest.approx(0.03)
    skin.short(5.64)
    assert skin.worst_uc == pytest.approx(0.03 / np.e, rel=1e-3)
    skin.short(100)
    assert skin.worst_uc < 1e-9
