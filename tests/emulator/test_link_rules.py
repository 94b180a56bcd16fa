"""The emulated link board on a clock of the test's own: kernels, limits, rules."""

import hashlib
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import KernelTableError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.link_host import give_kernels
from smarttouch.boards.link.protocol import NOTHING, HostSession, MessageKind, Refusal, Rule
from smarttouch.boards.link.sequence_encoding import (
    KernelImage,
    digest_of,
    encode_limits,
)
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.rules_over_time import Room
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence
from tests.boards.payloads import encode_lists

from ..raising import raises
from .rig import LinkRig

E = 6
NOBODY, FIVE = bytes(16), bytes([5] * 16)
"""Identities: of nothing, and of a table that is not there."""
MS = 1_000_000
LIMITS = SafetyLimits(E, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4)


def made_table(seed=0, kernels=5):
    weights = np.random.default_rng(seed).normal(size=(kernels, E))
    weights -= weights.mean(axis=1, keepdims=True)
    weights[1, 2:] = 0
    weights[1, :2] = 1, -1
    return KernelTable.of({Afferent.RA: weights}, {})


class KeptBooks(DeliveryLog):
    def keep(self, number, width_us, current_ua):
        self.kept.append(np.rint(current_ua).astype(int).tolist())


class Rig(LinkRig):
    """A board of six electrodes, and kernels for it; its ramp is that of any board."""

    def __init__(self, output="weighted", limits=LIMITS, kernel_bytes=10_000, ramp_ms=None):
        super().__init__(
            E, output, books=KeptBooks, limits=limits and encode_limits(limits),
            room=Room(kernel_bytes=kernel_bytes), ramp_ms=ramp_ms,
        )  # fmt: skip
        self.books.kept = []
        self.table = made_table()
        self.image = KernelImage.of(self.table, kernel_bytes, 100)

    def give(self, data, offset=0, identity=None, size=None, now_ms=0):
        identity = self.image.identity if identity is None else identity
        size = len(self.image.data) if size is None else size
        head = protocol.KERNELS.pack(identity, size, offset)
        (answer,) = self.say(now_ms, MessageKind.KERNELS, payload=head + data)
        *kept, self.proof = protocol.KEPT.unpack(answer.payload)
        return tuple(kept)

    def send(self, sequence, now_ms=0, number=1, image=None, times=1):
        payload = encode_lists(sequence, times, False, self.output != "weighted", image, 10**6)
        return self.refused(self.say(now_ms, MessageKind.SEQUENCE, number, payload))

    def refused(self, answers):
        found = [each.payload for each in answers if each.kind == MessageKind.NAK]
        return protocol.NAK.unpack(found[0]) if found else None

    def flowed(self):
        """Return what flowed once all was executed."""
        self.advance(9)
        return self.books.kept


def furnished():
    """Return a rig whose board has the kernels."""
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    return rig


@pytest.fixture
def rig():
    return Rig(ramp_ms=0)


def listed(table, amplitudes, **fields):
    """Return a sequence of one slot for each list of (kernel, amplitude)."""
    first = np.cumsum([0, *map(len, amplitudes)])
    pairs = np.array([each for slot in amplitudes for each in slot], np.uint16).reshape(-1, 2)
    sums = KernelLists(table, first, pairs[:, 0], pairs[:, 1])
    column = np.ones(len(amplitudes), np.uint16)
    values = {
        "current_ua": sums.current_ua(), "width_us": 100 * column, "discharge_us": 50 * column,
        "site": sums.site, "period_us": 10_000, "intensity": 1.0, "time_ns": 0, "sums": sums,
    }  # fmt: skip
    return ScanSequence(**(values | fields))


def plain(current, width_us=100, discharge_us=50, **fields):
    column = np.ones(len(current), np.uint16)
    values = {
        "current_ua": np.array(current, np.int16).reshape(-1, E), "site": 0 * column,
        "width_us": column * np.uint16(width_us), "discharge_us": column * np.uint16(discharge_us),
        "period_us": 10_000, "intensity": 1.0, "time_ns": 0,
    }  # fmt: skip
    return ScanSequence(**(values | fields))


def test_what_is_kept_outlives_a_session_and_is_resumed(rig):
    data, identity = rig.image.data, rig.image.identity
    assert rig.give(b"") == (identity, 0, 0)
    assert rig.give(data[:7]) == (identity, 7, 0)
    assert rig.give(data[:7]) == (identity, 7, 0), "what comes twice counts once"
    rig.say(1, MessageKind.STOP)
    rig.begin(1)
    assert rig.give(b"", now_ms=1) == (identity, 7, 0)
    assert rig.give(data[7:], 7, now_ms=1) == (identity, len(data), 1)
    rig.say(1, MessageKind.STOP)
    rig.begin(1)
    assert rig.give(b"", now_ms=1) == (identity, len(data), 1)


def test_another_table_takes_its_place_but_not_while_a_sequence_executes():
    rig = furnished()
    assert rig.send(listed(rig.table, [[(0, 4000)]]), image=rig.image) is None
    assert rig.give(b"", identity=FIVE, size=9, now_ms=1)[0] == rig.image.identity
    assert rig.give(b"", identity=FIVE, size=9, now_ms=11) == (FIVE, 0, 0)


@pytest.mark.parametrize("at", [0, 3, 5, 9, 20])
def test_what_is_no_table_is_not_kept(at):
    rig = Rig()
    broken = bytearray(rig.image.data)
    broken[at] ^= 1
    assert rig.give(bytes(broken)) == (NOBODY, 0, 0)
    own = hashlib.sha256(broken).digest()[:16]
    assert rig.give(bytes(broken), identity=own) == (NOBODY, 0, 0)


def test_more_than_there_is_room_for_is_left_out():
    rig = Rig(kernel_bytes=50)
    assert rig.image.count == 2
    assert rig.give(rig.image.data)[2] == 1
    assert rig.give(b"", identity=FIVE, size=51) == (NOBODY, 0, 0)
    sequence = listed(rig.table, [[(4, 4000)], [(0, 3000)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    # The one goes as currents, the other as a kernel.
    assert len(payload) == 10 + 4 + (4 + 2 + 2 * E) + (4 + 4)


def test_a_table_that_is_changed_after_it_was_sent_is_no_reference():
    rig = furnished()
    with pytest.raises(ValueError, match="read-only"):
        rig.table.weights[0] = 0
    object.__setattr__(rig.table, "weights", np.roll(rig.table.weights, 1, axis=1))
    sequence = listed(rig.table, [[(0, 4000)]])
    assert rig.send(sequence, image=rig.image) is None
    # As currents: the board's kernel would make others.
    assert rig.flowed() == sequence.current_ua.tolist()


@pytest.mark.parametrize(("first", "kernel", "amplitude"), [
    ([0, 1], np.array([0], np.uint16), np.array([-4000])),
    ([0, 1], np.array([0], np.uint16), np.array([4000 + 65_536])),
    ([0, 1], np.array([-5]), np.array([4000], np.uint16)),
    ([0, 1], np.array([99], np.uint16), np.array([4000], np.uint16)),
    ([0, 1], np.array([0, 0], np.uint16), np.array([3000, 1000], np.uint16)),
    ([1, 2], np.array([1, 0], np.uint16), np.array([9, 4000], np.uint16)),
])  # fmt: skip
def test_lists_that_the_wire_would_change_go_as_currents(first, kernel, amplitude):
    rig = furnished()
    sequence = listed(rig.table, [[(0, 4000)]])
    sums = KernelLists(rig.table, np.array(first), kernel, amplitude)
    current_ua = sums.current_ua() if amplitude[0] < 0 else sequence.current_ua
    sequence = listed(rig.table, [[(0, 4000)]], current_ua=current_ua, sums=sums)
    assert rig.send(sequence, image=rig.image) is None
    assert rig.flowed() == sequence.current_ua.tolist()


def test_currents_that_are_no_sum_go_as_they_are():
    rig = furnished()
    sequence = listed(rig.table, [[(0, 4000)]])
    changed = sequence.current_ua.copy()
    changed[0, :2] += [1, -1]
    sequence = listed(rig.table, [[(0, 4000)]], current_ua=changed)
    assert rig.send(sequence, image=rig.image) is None
    assert rig.flowed() == changed.tolist()


GOOD = [500, -500, 0, 0, 0, 0]
SLOT = Rule.NONE, NOTHING, NOTHING


@pytest.mark.parametrize(("sequence", "wanted"), [
    (plain([GOOD], period_us=4999), (Rule.PERIOD, NOTHING, NOTHING, 4999, 5000)),
    (plain([GOOD] * 2, width_us=[100, 201]), (Rule.WIDTH, 1, NOTHING, 201, 200)),
    (plain([GOOD], discharge_us=19), (Rule.DISCHARGE, 0, NOTHING, 19, 20)),
    (plain([GOOD] * 67), (Rule.FIT, NOTHING, NOTHING, 10_050, 10_000)),
    (plain([GOOD] * 50, width_us=170, discharge_us=20), (Rule.DUTY, NOTHING, NOTHING, 8500, 8000)),
    (plain([GOOD, [500, -499, 0, 0, 0, 0]]), (Rule.BALANCE, 1, NOTHING, 1, 0)),
    (plain([[0, 3001, -3001, 0, 0, 0]]), (Rule.CURRENT, 0, 1, 3001, 3000)),
    (plain([[0, 2600, -2600, 0, 0, 0]], width_us=200), (Rule.CHARGE, 0, 1, 520_000, 500_000)),
    (plain([[0, 2404, -2404, 0, 0, 0]]), None),
    (plain([[0, 2405, -2405, 0, 0, 0]]), (Rule.INTENSITY, NOTHING, NOTHING, 2405, 2404)),
    (plain([[0, 1205, -1205, 0, 0, 0]], intensity=0.5),
     (Rule.INTENSITY, NOTHING, NOTHING, 1205, 1204)),
    (plain([[0, 2000, -2000, 0, 0, 0]] * 26), (Rule.MEAN, NOTHING, 1, 5_200_000, 5_000_000)),
])  # fmt: skip
def test_refusals_give_rule_and_numbers(rig, sequence, wanted):
    assert rig.send(sequence) == (None if wanted is None else (Refusal.UNSAFE, *wanted))
    assert rig.books.violations == (wanted is not None)


def test_total_and_electrode_limits_are_the_sessions():
    each = (3.0, 1.0, 3.0, 3.0, 3.0, 3.0)
    limits = SafetyLimits(E, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4, total_ma=2.0, electrode_ma=each)
    rig = Rig(limits=limits, ramp_ms=0)
    over = plain([[1100, -1100, 0, 0, 0, 0]])
    assert rig.send(over) == (Refusal.UNSAFE, Rule.CURRENT, 0, 1, 1100, 1000)
    over = plain([[1100, 0, 1000, -1100, -1000, 0]])
    assert rig.send(over) == (Refusal.UNSAFE, Rule.TOTAL, 0, NOTHING, 2100, 2000)


def test_without_limits_and_without_kernels_nothing_flows():
    rig = Rig(limits=None, ramp_ms=0)
    assert rig.send(plain([GOOD]))[:2] == (Refusal.UNSAFE, Rule.LIMITS)
    rig = Rig(ramp_ms=0)
    found = rig.send(listed(rig.table, [[(0, 4000)]]), image=rig.image)
    assert found == (Refusal.UNSAFE, Rule.KERNEL, 0, NOTHING, 0, 0)
    rig.give(rig.image.data)
    heavy = [(each, 40_000) for each in range(5)]
    payload = bytes.fromhex("10270000 0100 ffff 00 01 6400 3200 01 00 0500")
    payload += np.array(heavy, "<u2").tobytes()
    found = rig.refused(rig.say(0, MessageKind.SEQUENCE, 1, payload))
    assert found == (Refusal.UNSAFE, Rule.SUM, 0, NOTHING, 200_000, 65_535)


def test_a_proof_is_of_the_table_and_the_session():
    rig = furnished()
    assert rig.proof == rig.image.proof(rig.host.number) != NOBODY
    before = rig.proof
    rig.say(1, MessageKind.STOP)
    rig.begin(1)
    rig.give(b"", now_ms=1)
    assert rig.proof == rig.image.proof(rig.host.number) != before


def test_a_table_of_the_same_size_is_not_taken_for_ours(rig):
    """The board compares the identity, and the host the proof."""
    ours = rig.image.data
    forged = KernelImage.of(made_table(seed=1), 10_000, 100).data
    assert len(forged) == len(ours)
    assert rig.give(forged) == (NOBODY, 0, 0)
    for data, session in ((forged, 5), (ours, 4)):
        proof = digest_of(session.to_bytes(8, "little") + data)
        kept = protocol.KEPT.pack(rig.image.identity, len(ours), 1, proof)
        line = SimpleNamespace(
            name="board", session=SimpleNamespace(number=5),
            ask=lambda *_, kept=kept: SimpleNamespace(payload=kept),
        )  # fmt: skip
        with raises(KernelTableError, names="kernels"):
            give_kernels(line, rig.image, 1000, lambda: None)


def test_an_emergency_switch_ends_a_session_at_once(rig):
    assert rig.send(plain([GOOD] * 30)) is None
    rig.advance(2)
    flowed = rig.books.slots
    rig.board.switch_open = True
    answers = rig.advance(3)
    told = [each for each in answers if each.kind == MessageKind.NAK]
    assert [protocol.NAK.unpack(each.payload)[0] for each in told] == [Refusal.EMERGENCY]
    assert all(each.state == protocol.SWITCH_OPEN for each in answers)
    assert (rig.books.state, rig.books.reason) == ("shorted", "emergency")
    assert rig.send(plain([GOOD]), 4, number=2)[0] == Refusal.EMERGENCY
    own, rig.host = rig.host, HostSession()
    rig.say(5, MessageKind.HELLO)
    assert rig.refused(rig.say(5, MessageKind.BEGIN))[0] == Refusal.EMERGENCY
    rig.host = own
    rig.board.switch_open = False
    rig.advance(6)
    assert rig.send(plain([GOOD]), 7, number=3)[0] == Refusal.EMERGENCY, "until BEGIN"
    rig.say(8, MessageKind.STOP)
    assert rig.send(plain([GOOD]), 8, number=4)[0] == Refusal.STOPPED
    rig.board.switch_open = True
    assert rig.send(plain([GOOD]), 9, number=5)[0] == Refusal.EMERGENCY, "while it is open"
    rig.board.switch_open = False
    rig.begin(9)
    rig.advance(20)
    assert rig.books.slots == flowed


def test_every_cut_of_a_payload_is_malformed():
    rig = furnished()
    sequence = listed(rig.table, [[(0, 4000)], [(1, 2001), (2, 400)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    # Cut between two groups it is whole.
    whole = {14, 22}
    for length in set(range(len(payload))) - whole:
        answers = rig.say(0, MessageKind.SEQUENCE, length + 1, payload[:length])
        assert rig.refused(answers)[0] == Refusal.MALFORMED, length
    assert rig.books.slots == 0
