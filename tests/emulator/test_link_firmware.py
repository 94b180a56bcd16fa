"""The emulated link board on a clock of the test's own, and what it keeps and executes.

What it refuses is compared with the C core and a judge in ``tests/firmware``.
"""

import hashlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import KernelTableError
from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.link_driver import give_kernels
from smarttouch.boards.link.protocol import (
    NOTHING,
    Feature,
    MessageKind,
    Refusal,
    Rule,
    decode_volts,
)
from smarttouch.boards.link.sequence_encoding import KernelImage, digest_of
from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog, read_slots
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.emulator.link_rules import Room
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence
from tests.boards.payloads import encode_lists

from ..raising import raises
from .rig import MS, LinkRig

E = 6
NOBODY, FIVE = bytes(16), bytes([5] * 16)
"""Identities: of nothing, and of a table that is not there."""
GOOD = [[300, -100, -100, -100], [-100, 300, -100, -100]]
"""Two pulses of 100 µs, 50 µs apart: 20, 20, −20 and −20 nC."""
BACK = [-20, -20, 20, 20]
"""In 1,000 µs."""


class Rig(LinkRig):
    def reason(self, *arguments, **options):
        found = self.refused(self.send(*arguments, **options))
        return found and Refusal(found[0])

    def refused(self, answers):
        """Return the numbers of a NAK; None without one."""
        found = [each.payload for each in answers if each.kind == MessageKind.NAK]
        return protocol.NAK.unpack(found[0]) if found else None

    def told(self, now_ms):
        return [(answer.kind, answer.about) for answer in self.advance(now_ms)]


@pytest.fixture
def rig():
    return Rig()


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


class KeptBooks(DeliveryLog):
    def keep(self, number, width_us, current_ua):
        self.kept.append(np.rint(current_ua).astype(int).tolist())


def made_table(seed=0, kernels=5):
    weights = np.random.default_rng(seed).normal(size=(kernels, E))
    weights -= weights.mean(axis=1, keepdims=True)
    weights[1, 2:] = 0
    weights[1, :2] = 1, -1
    return KernelTable.of({Afferent.RA: weights}, {})


class Keeper(Rig):
    """A board of six electrodes with room for kernels, and a table for it."""

    def __init__(self, kernel_bytes=10_000, **more):
        super().__init__(E, books=KeptBooks, room=Room(kernel_bytes=kernel_bytes), **more)
        self.books.kept = []
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


@pytest.fixture
def keeper():
    """A rig whose board has the kernels."""
    rig = Keeper()
    rig.give(rig.image.data)
    return rig


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
    for piece, at, kept in (
        (b"", 0, (7, 0)),
        (data[7:], 7, (len(data), 1)),
        (b"", 0, (len(data), 1)),
    ):
        rig.say(1, MessageKind.STOP)
        rig.begin(1)
        assert rig.give(piece, at, now_ms=1) == (identity, *kept)


def test_another_table_takes_its_place_but_not_while_a_sequence_executes(keeper):
    assert keeper.ask(listed(keeper.table, [[(0, 4000)]])) is None
    assert keeper.give(b"", identity=FIVE, size=9, now_ms=1)[0] == keeper.image.identity
    assert keeper.give(b"", identity=FIVE, size=9, now_ms=11) == (FIVE, 0, 0)


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
    found = Keeper(limits=None).refused(Keeper(limits=None).send(0, [[9, -9, 0, 0, 0, 0]]))
    assert found[:2] == (Refusal.UNSAFE, Rule.LIMITS)
    rig = Keeper()
    found = rig.ask(listed(rig.table, [[(0, 4000)]]))
    assert found == (Refusal.UNSAFE, Rule.KERNEL, 0, NOTHING, 0, 0)
    rig.give(rig.image.data)
    heavy = [(each, 40_000) for each in range(5)]
    payload = bytes.fromhex("10270000 0100 ffff 00 01 6400 3200 01 00 0500")
    payload += np.array(heavy, "<u2").tobytes()
    found = rig.refused(rig.say(0, MessageKind.SEQUENCE, 1, payload))
    assert found == (Refusal.UNSAFE, Rule.SUM, 0, NOTHING, 200_000, 65_535)


@pytest.mark.parametrize(("first", "kernel", "amplitude"), [
    ([0, 1], np.array([0], np.uint16), np.array([-4000])),
    ([0, 1], np.array([0], np.uint16), np.array([4000 + 65_536])),
    ([0, 1], np.array([-5]), np.array([4000], np.uint16)),
    ([0, 1], np.array([99], np.uint16), np.array([4000], np.uint16)),
    ([0, 1], np.array([0, 0], np.uint16), np.array([3000, 1000], np.uint16)),
    ([1, 2], np.array([1, 0], np.uint16), np.array([9, 4000], np.uint16)),
    ([0, 1], np.array([0], np.uint16), np.array([3999], np.uint16)),
])  # fmt: skip
def test_lists_that_would_make_other_currents_go_as_currents(keeper, first, kernel, amplitude):
    wanted = listed(keeper.table, [[(0, 4000)]]).current_ua
    sums = KernelLists(keeper.table, np.array(first), kernel, amplitude)
    wanted = sums.current_ua if amplitude[0] < 0 else wanted
    assert keeper.ask(listed(keeper.table, [[(0, 4000)]], current_ua=wanted, sums=sums)) is None
    keeper.advance(9)
    assert keeper.books.kept == wanted.tolist()


def test_nobody_can_change_a_table_or_its_lists(keeper):
    lists = listed(keeper.table, [[(0, 4000)]]).sums
    for array in (
        keeper.table.weights, keeper.table.site, lists.first, lists.kernel, lists.amplitude,
        lists.current_ua,
    ):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_a_host_takes_no_table_of_the_same_size_for_its_own():
    image = Keeper().image
    forged = KernelImage.of(made_table(seed=1), 10_000, 100).data
    for data, session in ((forged, 5), (image.data, 4)):
        proof = digest_of(session.to_bytes(8, "little") + data)
        kept = protocol.KEPT.pack(image.identity, len(image.data), 1, proof)
        line = SimpleNamespace(
            name="board", session=SimpleNamespace(number=5),
            ask=lambda *_, kept=kept: SimpleNamespace(payload=kept),
        )  # fmt: skip
        with raises(KernelTableError, names="kernels"):
            give_kernels(line, image, 1000)


def test_every_cut_of_a_payload_is_malformed(keeper):
    sequence = listed(keeper.table, [[(0, 4000)], [(1, 2001), (2, 400)]])
    payload = encode_lists(sequence, 1, False, False, keeper.image, 10**6)
    # Cut between two groups it is whole.
    for length in set(range(len(payload))) - {14, 22}:
        answers = keeper.say(0, MessageKind.SEQUENCE, length + 1, payload[:length])
        assert keeper.refused(answers)[0] == Refusal.MALFORMED, length
    assert keeper.books.slots == 0


@pytest.mark.parametrize("output", ["weighted", "three-state", "one-against-all"])
def test_only_a_board_with_a_source_for_each_electrode_recharges(output):
    features = protocol.CAPABILITIES.unpack_from(Rig(output=output).can.payload)[2]
    assert bool(features & Feature.RECHARGE) == (output == "weighted")


def test_a_recharge_takes_back_what_the_slots_have_passed(tmp_path):
    rig = Rig(folder=tmp_path)
    assert rig.reason(0, GOOD, recharge=np.int16(BACK), recharge_us=1000) is None
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
    assert phase["current_ua"].tolist() == BACK
    slots = read_slots(tmp_path)
    assert (slots["slot"].tolist(), slots["current_ua"].tolist()) == ([0, 1], GOOD)


@pytest.mark.parametrize(("at_ms", "share"), [(0.2, 0), (0.3, 0), (0.55, 0.25), (1.3, 1), (9, 1)])
def test_a_stop_cuts_a_recharge_off(rig, at_ms, share):
    rig.send(0, GOOD, recharge=np.int16(BACK), recharge_us=1000)
    rig.say(at_ms, MessageKind.STOP)
    rig.advance(50)
    left_uc = 0.02 * (1 - share)
    np.testing.assert_allclose(rig.books.passed_uc, np.multiply([1, 1, -1, -1], left_uc), atol=1e-9)
    assert rig.books.recharges == (share > 0)
    assert (rig.books.state, rig.books.reason) == ("shorted", "stop")


def test_silence_cuts_a_recharge_off_at_its_own_time(rig):
    back = np.int16([-2, -2, 2, 2])
    rig.send(0, GOOD * 300, recharge=back, recharge_us=20_000, period=400_000)
    rig.advance(300)
    # The phase began after 90 ms, and silence was noticed after 100.
    assert (rig.books.recharges, rig.books.reason) == (1, "silence")
    assert rig.books.passed_uc[0] == pytest.approx(300 * 0.02 - 2e-6 * 10_000)
