"""The emulated link board on a clock of the test's own: kernels, limits, rules."""

import hashlib
import math
import zlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import KernelTableError
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.handshake import give_kernels
from smarttouch.boards.link.protocol import NOTHING, HostSession, MessageKind, Refusal, Rule
from smarttouch.boards.link.sequence_encoding import (
    KernelImage,
    digest_of,
    encode_limits,
    encode_lists,
)
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence

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
            kernel_bytes=kernel_bytes, ramp_ms=ramp_ms,
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


def test_kernels_are_kept_and_added_up(rig):
    assert rig.give(rig.image.data) == (rig.image.identity, len(rig.image.data), 1)
    sequence = listed(rig.table, [[(0, 4000)], [(1, 2001)], [(2, 1500), (3, 777), (0, 31)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    assert len(payload) == 10 + 4 + 4 + 2 * 4 + 4 + 3 * 4
    assert rig.send(sequence, image=rig.image) is None
    assert rig.flowed() == sequence.current_ua.tolist()
    assert rig.books.kept[1] == [500, -500, 0, 0, 0, 0]


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
def test_rules_are_told_in_numbers(rig, sequence, wanted):
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


WEAK = [2, -2, 0, 0, 0, 0]


def of(intensity):
    """The weakest sequence that counts for as much as it claims."""
    level_ua = math.ceil(2400 * intensity / 2)
    return plain([[level_ua, -level_ua, 0, 0, 0, 0]], intensity=intensity)


def test_a_rise_is_the_boards_to_allow():
    rig = Rig()
    assert rig.send(of(1.0))[:2] == (Refusal.UNSAFE, Rule.RISE)
    assert rig.send(of(0.0)) is None
    assert rig.send(of(0.29), 11, number=2) is None
    assert rig.send(of(0.9), 30, number=3)[1] == Rule.RISE
    for step in range(1, 51):
        now_ms = 30 + 10 * step
        rig.say(now_ms, MessageKind.HEARTBEAT)
        found = rig.send(of(min(1.0, 0.02 * step)), now_ms, number=3 + step)
        assert found is None, step
    # It may fall at once, and comes back as slowly as it rose.
    assert rig.send(of(0.1), 540, number=60) is None
    assert rig.send(of(1.0), 551, number=61)[1] == Rule.RISE


def test_weak_current_opens_a_multiple_of_itself():
    """Whatever it claims, for a whole ramp; and what is open stays so while it flows."""
    rig = Rig()
    one = plain([[30, -30, 0, 0, 0, 0]])
    for number in range(60):
        assert rig.send(one, 10 * number, number=number) is None
    found = rig.send(of(0.5), 600, number=100)
    # 4 x ceil(1/160 of 65,535), 150 ms of a ramp of 500 and 2.
    assert (found[1], found[4:]) == (Rule.RISE, (32_768, 4 * 410 + 19_660 + 2))
    for step in range(1, 60):
        assert rig.send(of(min(1.0, 0.02 * step)), 600 + 10 * step, number=100 + step) is None
    for step in range(60, 100):
        assert rig.send(one, 600 + 10 * step, number=100 + step) is None
    assert rig.send(of(1.0), 1600, number=300) is None


def quiet(rig, start_ms, end_ms, number):
    """Keep a board alive without current, with sequences of full intensity that claim it."""
    for now_ms in range(start_ms, end_ms, 50):
        assert rig.send(plain([], intensity=0.2), now_ms, number=number) is None
        number += 1
    return number


@pytest.mark.parametrize(("silent_ms", "kept"), [(14_900, True), (15_100, False)])
def test_a_level_is_opened_by_current_and_closed_by_a_long_silence(silent_ms, kept):
    rig = Rig()
    number = quiet(rig, 0, 2000, 1)
    assert rig.send(of(0.4), 2000, number=number)[1] == Rule.RISE
    for step in range(50):
        assert rig.send(of(min(1.0, 0.02 * step)), 2000 + 10 * step, number=100 + step) is None
    number = quiet(rig, 2500, 2500 + silent_ms, 200)
    found = rig.send(of(1.0), 2500 + silent_ms, number=number)
    assert (found is None) == kept


def test_recharge_phases_are_checked(rig):
    back = np.array([-100, 100, 0, 0, 0, 0], np.int16)
    assert rig.send(plain([GOOD], recharge_ua=back, recharge_us=500)) is None
    over = 6 * back
    found = rig.send(plain([GOOD], recharge_ua=over, recharge_us=500), 1, number=2)
    assert found == (Refusal.UNSAFE, Rule.CURRENT, NOTHING, 0, 600, 500)
    found = rig.send(plain([GOOD], recharge_ua=back, recharge_us=9900), 1, number=2)
    assert found == (Refusal.UNSAFE, Rule.FIT, NOTHING, NOTHING, 10_070, 10_000)


def repeated(rig, sequence, count, step_ms=10, number=1):
    """Send a sequence again and again; return the first refusal, and how many were taken before."""
    for index in range(count):
        found = rig.send(sequence, step_ms * index, number=number + index)
        if found is not None:
            return found, index
        rig.advance(step_ms * index + step_ms / 2)
    return None, count


def test_what_a_second_brings_is_bounded():
    """Each is within the bounds of its own period."""
    strong = plain([[1000, -1000, 0, 0, 0, 0]] * 3 + [[-1000, 1000, 0, 0, 0, 0]] * 3)
    assert repeated(Rig(ramp_ms=0), strong, 200) == (None, 200)
    net = plain([[2400, -2400, 0, 0, 0, 0]], width_us=200)
    found, taken = repeated(Rig(ramp_ms=0), net, 200)
    assert (found[1], found[3], taken) == (Rule.NET_IN_SECOND, 0, 104)
    often = plain([[1300, -1300, 0, 0, 0, 0], [-1300, 1300, 0, 0, 0, 0]] * 27, period_us=40_000)
    assert repeated(Rig(ramp_ms=0), often, 60, 40) == (None, 60)
    # Sessions that follow one another cut what executes.
    rig, found, taken = Rig(ramp_ms=0), None, -1
    while found is None:
        taken += 1
        rig.say(taken, MessageKind.STOP)
        rig.begin(taken)
        found = rig.send(plain([]), taken)
    assert (found[:2], found[4:], taken) == ((Refusal.UNSAFE, Rule.OFTEN), (202, 201), 201)


def test_repetitions_are_judged_before_the_first_begins(rig):
    net = plain([[2400, -2400, 0, 0, 0, 0]], width_us=200)
    found = rig.send(replace(net, period_us=9000), times=112)
    assert found[:2] == (Refusal.UNSAFE, Rule.NET_IN_SECOND)
    assert rig.books.slots == 0


def test_a_session_ends():
    limits = SafetyLimits(E, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4, session_s=2, session_mc=0.004)
    rig = Rig(limits=limits, ramp_ms=0)
    both = plain([[1000, -1000, 0, 0, 0, 0], [-1000, 1000, 0, 0, 0, 0]])
    found, taken = repeated(rig, both, 100)
    assert (found[1], found[4:], taken) == (Rule.SESSION_CHARGE, (5, 4), 20)
    rig = Rig(limits=limits, ramp_ms=0)
    found = rig.send(plain([WEAK]), times=201)
    assert (found[1], found[4:]) == (Rule.SESSION_TIME, (3, 2))


NAMES = ("period", "total", "width", "full", "rounding", "full_us", "ramp", "session_s",
         "session_uc", "duty", "nothing", "usual")  # fmt: skip


def limited(name, value, **given):
    """Return a rig whose limits have another value in one field."""
    usual, rig = encode_limits(LIMITS), Rig(limits=None, **given)
    fields = dict(zip(NAMES, protocol.LIMITS.unpack_from(usual), strict=True))
    head = protocol.LIMITS.pack(*(fields | {name: value}).values())
    rig.say(0, MessageKind.LIMITS, payload=head + usual[protocol.LIMITS.size :])
    return rig


def test_what_limits_ask_for_is_capped_and_what_is_left_out_is_safe():
    full = plain([[2600, -2600, 0, 0, 0, 0]], width_us=20, intensity=0.1)
    for name, value in (("full", 65_535), ("rounding", 5000)):
        assert limited(name, value, ramp_ms=0).send(full)[1] == Rule.INTENSITY, name
    for name in ("ramp", "usual"):
        # A ramp that is left out is the longest; and any pulse is more than one of no width.
        assert limited(name, 0, ramp_ms=500).send(of(0.1))[1] == Rule.RISE
    for name in ("total", "width", "full", "session_s", "session_uc", "duty"):
        assert limited(name, 0, ramp_ms=0).send(plain([GOOD]))[0] == Refusal.UNSAFE, name


def test_one_source_counts_as_one_electrode():
    shared = plain([[3000, -750, -750, -750, -750, 0]])
    rig = Rig("three-state", ramp_ms=0)
    split = plain([[1500, 1500, -3000, 0, 0, 0]], width_us=170)
    assert rig.send(shared)[1] in (Rule.CURRENT, Rule.INTENSITY)
    found = rig.send(split, number=2)
    assert found[:2] == (Refusal.UNSAFE, Rule.CHARGE)


def test_a_proof_is_of_the_table_and_the_session():
    rig = furnished()
    assert rig.proof == rig.image.proof(rig.host.number) != NOBODY
    before = rig.proof
    rig.say(1, MessageKind.STOP)
    rig.begin(1)
    rig.give(b"", now_ms=1)
    assert rig.proof == rig.image.proof(rig.host.number) != before


def test_a_table_with_the_same_crc_and_size_is_not_taken_for_ours(rig):
    """Four bytes make any CRC-32; the board compares the identity, the host the proof."""
    ours = rig.image.data
    forged = with_crc(KernelImage.of(made_table(seed=1), 10_000, 100).data, zlib.crc32(ours))
    assert (len(forged), zlib.crc32(forged)) == (len(ours), zlib.crc32(ours))
    assert rig.give(forged) == (NOBODY, 0, 0)
    for data, session in ((forged, 5), (ours, 4)):
        proof = digest_of(session.to_bytes(8, "little") + data)
        kept = protocol.KEPT.pack(rig.image.identity, len(ours), 1, proof)
        line = SimpleNamespace(
            name="board", session=SimpleNamespace(number=5),
            ask=lambda *_, kept=kept: SimpleNamespace(payload=kept),
        )  # fmt: skip
        with raises(KernelTableError, about="kernels"):
            give_kernels(line, rig.image, 1000, lambda: None)


def with_crc(data, crc):
    """Return data of the same length whose CRC-32 is as given: its last four bytes are chosen."""
    head = data[:-4]
    base = zlib.crc32(head + bytes(4))
    columns = [zlib.crc32(head + (1 << bit).to_bytes(4, "little")) ^ base for bit in range(32)]
    wanted, chosen = base ^ crc, 0
    rows = []
    for bit, column in enumerate(columns):
        mask = 1 << bit
        for pivot, other, made in rows:
            if column >> pivot & 1:
                column, mask = column ^ other, mask ^ made
        pivot = column.bit_length() - 1
        rows.append((pivot, column, mask))
    for pivot, column, mask in sorted(rows, reverse=True):
        if wanted >> pivot & 1:
            wanted, chosen = wanted ^ column, chosen ^ mask
    assert wanted == 0
    return head + chosen.to_bytes(4, "little")


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


@pytest.mark.parametrize("output", ["three-state", "one-against-all"])
def test_switched_boards_take_states(output):
    rig = Rig(output, ramp_ms=0)
    assert rig.send(plain([[500, -100, -100, -100, -100, -100]])) is None
    (kept,) = rig.flowed()
    assert kept[0] > 0 > max(kept[1:])
    found = rig.send(plain([[0, 0, 0, 0, 0, 0]]), 12, number=2)
    assert found[:3] == (Refusal.UNSAFE, Rule.STATES, 0)


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
