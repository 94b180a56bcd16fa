"""The emulated link board on a clock of the test's own: what it keeps, hears and executes.

What it refuses is compared with the C core and a judge in ``tests/firmware``.
"""

import hashlib
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import KernelTableError
from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.link_driver import give_kernels
from smarttouch.boards.link.protocol import (
    ALIVE_MS,
    LATE_MS,
    LONGEST_PACKET_MS,
    NOTHING,
    HostSession,
    Message,
    MessageKind,
    Refusal,
    Rule,
    decode,
    decode_volts,
    digest_of,
)
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.emulator.firmware import DeliveryLog, read_slots
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.link_packets import MOST_HOSTS, BoardSession
from smarttouch.emulator.link_rules import Room
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence
from tests.boards.payloads import encode_lists, limits_payload, sequence_payload

from ..raising import raises

MS = 1_000_000
E = 6
NOBODY, FIVE = bytes(16), bytes([5] * 16)
"""Identities: of nothing, and of a table that is not there."""
GOOD = [[300, -100, -100, -100], [-100, 300, -100, -100]]
"""Two pulses of 100 µs, 50 µs apart: 20, 20, −20 and −20 nC."""
BACK = np.int16([-20, -20, 20, 20])
"""In 1,000 µs."""


class KeptBooks(DeliveryLog):
    def keep(self, number, width_us, current_ua):
        self.kept.append(np.rint(current_ua).astype(int).tolist())


class Rig:
    """A board, and a session begun at time zero, under limits if they are not None."""

    def __init__(self, electrodes=4, output="weighted", *, folder=None, limits=b"", **given):
        self.output, self.now_ms, self.sent = output, 0, []
        limits = limits_payload(electrodes) if limits == b"" else limits
        self.books = KeptBooks(electrodes, folder)
        self.books.kept = []
        self.board = LinkFirmware(output, self.books, **{"ramp_ms": 0} | given)
        self.begin(0, limits)

    def begin(self, now_ms, limits=None):
        self.host = HostSession()
        (self.can,) = self.say(now_ms, MessageKind.HELLO)
        (begun,) = self.say(now_ms, MessageKind.BEGIN)
        assert (self.can.kind, begun.kind) == (MessageKind.CAPABILITIES, MessageKind.BEGUN)
        if limits is not None:
            (answer,) = self.say(now_ms, MessageKind.LIMITS, payload=limits)
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
        packets = [self.host.take(packet) or decode(packet) for packet in Deframer().feed(data)]
        return [packet for packet in packets if packet.kind != MessageKind.ALIVE]

    def send(
        self, now_ms, current, *, number=1, width=100, discharge=50, period=10_000, times=1,
        measure=False, recharge=None, recharge_us=0,
    ):  # fmt: skip
        """Send a sequence; return what is refused of it, None if nothing is."""
        current = np.asarray(current, np.int16)
        column = np.ones(len(current), np.uint16)
        payload = sequence_payload(
            self.output, period, column * width, column * discharge, column, current,
            times, measure, recharge, recharge_us,
        )  # fmt: skip
        return self.refused(self.say(now_ms, MessageKind.SEQUENCE, number, payload))

    def refused(self, answers):
        """Return the numbers of a NAK; None without one."""
        found = [each.payload for each in answers if each.kind == MessageKind.NAK]
        return protocol.NAK.unpack(found[0]) if found else None

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


class Keeper(Rig):
    """A board of six electrodes with room for kernels, and a table for it."""

    def __init__(self, kernel_bytes=10_000, **more):
        super().__init__(E, room=Room(kernel_bytes=kernel_bytes), **more)
        self.table = made_table()
        self.image = KernelImage.of(self.table, kernel_bytes, 100)

    def give(self, data, offset=0, identity=None, size=None, now_ms=0):
        identity = self.image.identity if identity is None else identity
        size = len(self.image.data) if size is None else size
        head = protocol.KERNELS.pack(identity, size, offset)
        (answer,) = self.say(now_ms, MessageKind.KERNELS, payload=head + data)
        return protocol.KEPT.unpack(answer.payload)[:3]

    def ask(self, sequence):
        """Send a sequence by kernels where the board keeps them."""
        payload = encode_lists(sequence, 1, False, False, self.image, 10**6)
        return self.refused(self.say(0, MessageKind.SEQUENCE, 1, payload))


def listed(table, amplitudes, **fields):
    """Return a sequence of one slot for each list of (kernel, amplitude)."""
    first = np.cumsum([0, *map(len, amplitudes)])
    pairs = np.array([each for slot in amplitudes for each in slot], np.uint16).reshape(-1, 2)
    sums = KernelLists(table, first, pairs[:, 0], pairs[:, 1])
    column = np.ones(len(amplitudes), np.uint16)
    values = {
        "current_ua": sums.current_ua, "width_us": 100 * column, "discharge_us": 50 * column,
        "site": sums.site, "period_us": 10_000, "intensity": 1.0, "time_ns": 0, "sums": sums,
    }  # fmt: skip
    return ScanSequence(**(values | fields))


def test_what_is_kept_outlives_a_session_and_is_resumed():
    rig = Keeper()
    data, identity = rig.image.data, rig.image.identity
    assert rig.give(b"") == (identity, 0, 0)
    assert rig.give(data[:7]) == (identity, 7, 0)
    assert rig.give(data[:7]) == (identity, 7, 0), "what comes twice counts once"
    for piece, at, kept in ((b"", 0, (7, 0)), (data[7:], 7, (len(data), 1))):
        rig.say(1, MessageKind.STOP)
        rig.begin(1, limits_payload(E))
        assert rig.give(piece, at, now_ms=1) == (identity, *kept)
    # Another table takes its place, but not while a sequence executes.
    assert rig.ask(listed(rig.table, [[(0, 4000)]])) is None
    assert rig.give(b"", identity=FIVE, size=9, now_ms=2)[0] == identity
    assert rig.give(b"", identity=FIVE, size=9, now_ms=12) == (FIVE, 0, 0)


@pytest.mark.parametrize("at", [0, 3, 5, 9, 20])
def test_what_is_no_table_is_not_kept(at):
    rig = Keeper()
    broken = bytearray(rig.image.data)
    broken[at] ^= 1
    assert rig.give(bytes(broken)) == (NOBODY, 0, 0)
    own = hashlib.sha256(broken).digest()[:16]
    assert rig.give(bytes(broken), identity=own) == (NOBODY, 0, 0)


def test_more_than_there_is_room_for_is_left_out():
    rig = Keeper(kernel_bytes=50)
    assert rig.image.count == 2
    assert rig.give(rig.image.data)[2] == 1
    assert rig.give(b"", identity=FIVE, size=51) == (NOBODY, 0, 0)
    sequence = listed(rig.table, [[(4, 4000)], [(0, 3000)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    # The one goes as currents, the other as a kernel.
    assert len(payload) == 10 + 4 + (4 + 2 + 2 * E) + (4 + 4)


def test_without_limits_and_without_kernels_nothing_flows():
    found = Keeper(limits=None).send(0, [[9, -9, 0, 0, 0, 0]])
    assert found[:2] == (Refusal.UNSAFE, Rule.LIMITS)
    found = Keeper().ask(listed(made_table(), [[(0, 4000)]]))
    assert found is None, "of another table, these go as currents"
    rig = Keeper()
    found = rig.ask(listed(rig.table, [[(0, 4000)]]))
    assert found == (Refusal.UNSAFE, Rule.KERNEL, 0, NOTHING, 0, 0)


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
    keeper = Keeper()
    keeper.give(keeper.image.data)
    wanted = listed(keeper.table, [[(0, 4000)]]).current_ua
    sums = KernelLists(keeper.table, np.array(first), kernel, amplitude)
    wanted = sums.current_ua if amplitude[0] < 0 else wanted
    assert keeper.ask(listed(keeper.table, [[(0, 4000)]], current_ua=wanted, sums=sums)) is None
    keeper.advance(9)
    assert keeper.books.kept == wanted.tolist()


def test_a_host_takes_no_table_of_the_same_size_for_its_own():
    image = Keeper().image
    forged = KernelImage.of(made_table(seed=1), 10_000, 100).data
    for data, session in ((forged, 5), (image.data, 4)):
        proof = digest_of(data, session)
        kept = protocol.KEPT.pack(image.identity, len(image.data), 1, proof)
        line = SimpleNamespace(
            name="board", session=SimpleNamespace(number=5),
            ask=lambda *_, kept=kept: SimpleNamespace(payload=kept),
        )  # fmt: skip
        with raises(KernelTableError, names="kernels"):
            give_kernels(line, image, 1000)


# -- recharge phases ---------------------------------------------------------


def test_a_recharge_takes_back_what_the_slots_have_passed(tmp_path):
    rig = Rig(folder=tmp_path)
    assert rig.send(0, GOOD, recharge=BACK, recharge_us=1000) is None
    rig.advance(5)
    np.testing.assert_allclose(rig.books.passed_uc, [0.02, 0.02, -0.02, -0.02])
    rig.advance(10)
    np.testing.assert_allclose(rig.books.passed_uc, 0, atol=1e-12)
    assert (rig.books.slots, rig.books.pulses, rig.books.recharges) == (2, 8, 1)
    assert (rig.books.violations, rig.books.unsafe) == (0, 0)
    assert rig.books.max_charge_uc == pytest.approx(0.03)
    assert rig.books.max_net_charge_uc < 1e-3
    rig.books.write()
    (phase,) = read_slots(tmp_path, recharges=True)
    assert (phase["number"], phase["time_us"]) == (1, 300)
    assert phase["current_ua"].tolist() == BACK.tolist()
    slots = read_slots(tmp_path)
    assert (slots["slot"].tolist(), slots["current_ua"].tolist()) == ([0, 1], GOOD)


@pytest.mark.parametrize(("at_ms", "share"), [(0.2, 0), (0.3, 0), (0.55, 0.25), (1.3, 1), (9, 1)])
def test_a_stop_cuts_a_recharge_off(rig, at_ms, share):
    rig.send(0, GOOD, recharge=BACK, recharge_us=1000)
    rig.say(at_ms, MessageKind.STOP)
    rig.advance(50)
    left_uc = 0.02 * (1 - share)
    np.testing.assert_allclose(rig.books.passed_uc, np.multiply([1, 1, -1, -1], left_uc), atol=1e-9)
    assert rig.books.recharges == (share > 0)
    assert rig.ended == ("shorted", "stop")


def test_silence_cuts_a_recharge_off_at_its_own_time(rig):
    back = np.int16([-2, -2, 2, 2])
    rig.send(0, GOOD * 300, recharge=back, recharge_us=20_000, period=400_000)
    rig.advance(300)
    # The phase began after 90 ms, and silence was noticed after 100.
    assert (rig.books.recharges, rig.books.reason) == (1, "silence")
    assert rig.books.passed_uc[0] == pytest.approx(300 * 0.02 - 2e-6 * 10_000)
