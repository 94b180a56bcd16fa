"""The emulated board of version 4 on a clock of the test's own: kernels, limits, rules."""

import zlib

import numpy as np
import pytest

from smarttouch.afferent import Afferent
from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.emulator.delivery_log import DeliveryLog
from smarttouch.boards.emulator.link4 import Link4Firmware
from smarttouch.boards.link_kernels import KernelImage
from smarttouch.boards.link_lists import encode_limits, encode_lists
from smarttouch.boards.link_protocol import NOTHING, Kind, Refusal, Rule
from smarttouch.boards.link_session import HostSession
from smarttouch.stimulation.kernel_table import KernelLists, KernelTable
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence
from smarttouch.wire.framing import Deframer

E = 6
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


class Rig:
    """A board with limits and kernels, and a session begun at time zero."""

    def __init__(self, output="weighted", limits=LIMITS, kernel_bytes=10_000, **given):
        self.books = KeptBooks(E)
        self.books.kept = []
        self.output = output
        self.board = Link4Firmware(E, output, self.books, kernel_bytes=kernel_bytes, **given)
        self.begin()
        self.limits = limits
        if limits is not None:
            (answer,) = self.say(0, Kind.LIMITS, payload=encode_limits(limits))
            assert (answer.kind, answer.payload) == (Kind.LIMITED, b"\1")
        self.table = made_table()
        self.image = KernelImage.of(self.table, kernel_bytes, 100)

    def begin(self, now_ms=0):
        self.host = HostSession(version=4)
        assert [each.kind for each in self.say(now_ms, Kind.HELLO)] == [Kind.CAPABILITIES]
        assert [each.kind for each in self.say(now_ms, Kind.BEGIN)] == [Kind.BEGUN]

    def say(self, now_ms, kind, about=0, payload=b""):
        data = self.board.feed(self.host.encode(kind, about, payload), int(now_ms * MS))
        packets = [self.host.take(packet) for packet in Deframer().feed(data)]
        return [each for each in packets if each.kind != Kind.ALIVE]

    def give(self, data, offset=0, identity=None, size=None, now_ms=0):
        identity = self.image.identity if identity is None else identity
        size = len(self.image.data) if size is None else size
        head = protocol.KERNELS.pack(identity, size, offset)
        (answer,) = self.say(now_ms, Kind.KERNELS, payload=head + data)
        return protocol.KEPT.unpack(answer.payload)

    def send(self, sequence, now_ms=0, number=1, image=None):
        payload = encode_lists(sequence, 1, False, self.output != "weighted", image, 10**6)
        return self.refused(self.say(now_ms, Kind.SEQUENCE, number, payload))

    def refused(self, answers):
        found = [each.payload for each in answers if each.kind == Kind.NAK]
        return protocol.NAK.unpack(found[0]) if found else None


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


def plain(current, **fields):
    column = np.ones(len(current), np.uint16)
    values = {
        "current_ua": np.array(current, np.int16).reshape(-1, E), "width_us": 100 * column,
        "discharge_us": 50 * column, "site": 0 * column, "period_us": 10_000, "intensity": 1.0,
        "time_ns": 0,
    }  # fmt: skip
    return ScanSequence(**(values | fields))


def test_kernels_are_kept_and_added_up():
    rig = Rig(ramp_ms=0)
    assert rig.give(rig.image.data) == (rig.image.identity, len(rig.image.data), 1)
    sequence = listed(rig.table, [[(0, 4000)], [(1, 2001)], [(2, 1500), (3, 777), (0, 31)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    assert len(payload) == 10 + 4 + 4 + 2 * 4 + 4 + 3 * 4
    assert rig.send(sequence, image=rig.image) is None
    rig.board.advance(9 * MS)
    assert rig.books.kept == sequence.current_ua.tolist()
    assert rig.books.kept[1] == [500, -500, 0, 0, 0, 0]


def test_what_is_kept_outlives_a_session_and_is_resumed():
    rig = Rig(ramp_ms=0)
    data, identity = rig.image.data, rig.image.identity
    assert rig.give(b"") == (identity, 0, 0)
    assert rig.give(data[:7]) == (identity, 7, 0)
    assert rig.give(data[:7]) == (identity, 7, 0), "what comes twice counts once"
    rig.say(1, Kind.STOP)
    rig.begin(1)
    assert rig.give(b"", now_ms=1) == (identity, 7, 0)
    assert rig.give(data[7:], 7, now_ms=1) == (identity, len(data), 1)
    rig.say(1, Kind.STOP)
    rig.begin(1)
    assert rig.give(b"", now_ms=1) == (identity, len(data), 1)


def test_another_table_takes_its_place_but_not_while_a_sequence_executes():
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    assert rig.send(listed(rig.table, [[(0, 4000)]]), image=rig.image) is None
    assert rig.give(b"", identity=5, size=9, now_ms=1)[0] == rig.image.identity
    assert rig.give(b"", identity=5, size=9, now_ms=11) == (5, 0, 0)


@pytest.mark.parametrize("at", [0, 3, 5, 9, 20])
def test_what_is_no_table_is_not_kept(at):
    rig = Rig()
    broken = bytearray(rig.image.data)
    broken[at] ^= 1
    assert rig.give(bytes(broken)) == (0, 0, 0)
    assert rig.give(bytes(broken), identity=zlib.crc32(broken)) == (0, 0, 0)


def test_more_than_there_is_room_for_is_left_out():
    rig = Rig(kernel_bytes=50)
    assert rig.image.count == 2
    assert rig.give(rig.image.data)[2] == 1
    assert rig.give(b"", identity=9, size=51) == (0, 0, 0)
    sequence = listed(rig.table, [[(4, 4000)], [(0, 3000)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    # The one goes as currents, the other as a kernel.
    assert len(payload) == 10 + 4 + (4 + 2 + 2 * E) + (4 + 4)


def test_a_table_that_is_changed_after_it_was_sent_is_no_reference():
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    rig.table.weights[0] = np.roll(rig.table.weights[0], 1)
    sequence = listed(rig.table, [[(0, 4000)]])
    assert rig.send(sequence, image=rig.image) is None
    rig.board.advance(9 * MS)
    # As currents: the board's kernel would make others.
    assert rig.books.kept == sequence.current_ua.tolist()


@pytest.mark.parametrize(
    ("first", "kernel", "amplitude"),
    [
        ([0, 1], np.array([0], np.uint16), np.array([-4000])),
        ([0, 1], np.array([0], np.uint16), np.array([4000 + 65_536])),
        ([0, 1], np.array([-5]), np.array([4000], np.uint16)),
        ([0, 1], np.array([99], np.uint16), np.array([4000], np.uint16)),
        ([0, 1], np.array([0, 0], np.uint16), np.array([3000, 1000], np.uint16)),
        ([1, 2], np.array([1, 0], np.uint16), np.array([9, 4000], np.uint16)),
    ],
)
def test_lists_that_the_wire_would_change_go_as_currents(first, kernel, amplitude):
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    sequence = listed(rig.table, [[(0, 4000)]])
    sums = KernelLists(rig.table, np.array(first), kernel, amplitude)
    current_ua = sums.current_ua() if amplitude[0] < 0 else sequence.current_ua
    sequence = listed(rig.table, [[(0, 4000)]], current_ua=current_ua, sums=sums)
    assert rig.send(sequence, image=rig.image) is None
    rig.board.advance(9 * MS)
    assert rig.books.kept == sequence.current_ua.tolist()


def test_currents_that_are_no_sum_go_as_they_are():
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    sequence = listed(rig.table, [[(0, 4000)]])
    changed = sequence.current_ua.copy()
    changed[0, :2] += [1, -1]
    sequence = listed(rig.table, [[(0, 4000)]], current_ua=changed)
    assert rig.send(sequence, image=rig.image) is None
    rig.board.advance(9 * MS)
    assert rig.books.kept == changed.tolist()


GOOD = [500, -500, 0, 0, 0, 0]
SLOT = Rule.NONE, NOTHING, NOTHING


@pytest.mark.parametrize(
    ("sequence", "wanted"),
    [
        (plain([GOOD], period_us=4999), (Rule.PERIOD, NOTHING, NOTHING, 4999, 5000)),
        (
            plain([GOOD] * 2, width_us=np.array([100, 201], np.uint16)),
            (Rule.WIDTH, 1, NOTHING, 201, 200),
        ),
        (
            plain([GOOD], discharge_us=np.array([19], np.uint16)),
            (Rule.DISCHARGE, 0, NOTHING, 19, 20),
        ),
        (plain([GOOD] * 67), (Rule.FIT, NOTHING, NOTHING, 10_050, 10_000)),
        (
            plain([GOOD] * 50, width_us=np.full(50, 170, np.uint16),
                  discharge_us=np.full(50, 20, np.uint16)),
            (Rule.DUTY, NOTHING, NOTHING, 8500, 8000),
        ),
        (plain([GOOD, [500, -499, 0, 0, 0, 0]]), (Rule.BALANCE, 1, NOTHING, 1, 0)),
        (plain([[0, 3001, -3001, 0, 0, 0]]), (Rule.CURRENT, 0, 1, 3001, 3000)),
        (
            plain([[0, 2600, -2600, 0, 0, 0]], width_us=np.array([200], np.uint16)),
            (Rule.CHARGE, 0, 1, 520_000, 500_000),
        ),
        (plain([[0, 2404, -2404, 0, 0, 0]]), None),
        (
            plain([[0, 2405, -2405, 0, 0, 0]]),
            (Rule.INTENSITY, NOTHING, NOTHING, 2405, 2404),
        ),
        (
            plain([[0, 1205, -1205, 0, 0, 0]], intensity=0.5),
            (Rule.INTENSITY, NOTHING, NOTHING, 1205, 1204),
        ),
        (
            plain([[0, 2000, -2000, 0, 0, 0]] * 26),
            (Rule.MEAN, NOTHING, 1, 5_200_000, 5_000_000),
        ),
    ],
)  # fmt: skip
def test_rules_are_told_in_numbers(sequence, wanted):
    rig = Rig(ramp_ms=0)
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
    found = rig.refused(rig.say(0, Kind.SEQUENCE, 1, payload))
    assert found == (Refusal.UNSAFE, Rule.SUM, 0, NOTHING, 200_000, 65_535)


def test_a_rise_is_the_boards_to_allow():
    rig = Rig()
    assert rig.send(plain([], intensity=1.0))[:2] == (Refusal.UNSAFE, Rule.RISE)
    assert rig.send(plain([], intensity=0.0)) is None
    assert rig.send(plain([], intensity=0.29), 1, number=2) is None
    assert rig.send(plain([], intensity=0.9), 30, number=3)[1] == Rule.RISE
    for step in range(1, 26):
        now_ms = 30 + 20 * step
        rig.say(now_ms, Kind.HEARTBEAT)
        found = rig.send(plain([], intensity=min(1.0, 0.04 * step)), now_ms, number=3 + step)
        assert found is None, step
    # It may fall at once, and comes back as slowly as it rose.
    assert rig.send(plain([], intensity=0.1), 550, number=40) is None
    assert rig.send(plain([], intensity=1.0), 560, number=41)[1] == Rule.RISE


def test_recharge_phases_are_checked():
    rig = Rig(ramp_ms=0)
    back = np.array([-100, 100, 0, 0, 0, 0], np.int16)
    assert rig.send(plain([GOOD], recharge_ua=back, recharge_us=500)) is None
    over = 6 * back
    found = rig.send(plain([GOOD], recharge_ua=over, recharge_us=500), 1, number=2)
    assert found == (Refusal.UNSAFE, Rule.CURRENT, NOTHING, 0, 600, 500)
    found = rig.send(plain([GOOD], recharge_ua=back, recharge_us=9900), 1, number=2)
    assert found == (Refusal.UNSAFE, Rule.FIT, NOTHING, NOTHING, 10_050, 10_000)


@pytest.mark.parametrize("output", ["three-state", "one-against-all"])
def test_switched_boards_take_states(output):
    rig = Rig(output, ramp_ms=0)
    assert rig.send(plain([[500, -100, -100, -100, -100, -100]])) is None
    rig.board.advance(9 * MS)
    (kept,) = rig.books.kept
    assert kept[0] > 0 > max(kept[1:])
    found = rig.send(plain([[0, 0, 0, 0, 0, 0]]), 12, number=2)
    assert found[:3] == (Refusal.UNSAFE, Rule.STATES, 0)


def test_every_cut_of_a_payload_is_malformed():
    rig = Rig(ramp_ms=0)
    rig.give(rig.image.data)
    sequence = listed(rig.table, [[(0, 4000)], [(1, 2001), (2, 400)]])
    payload = encode_lists(sequence, 1, False, False, rig.image, 10**6)
    # Cut between two groups it is whole.
    whole = {14, 22}
    for length in set(range(len(payload))) - whole:
        answers = rig.say(0, Kind.SEQUENCE, length + 1, payload[:length])
        assert rig.refused(answers)[0] == Refusal.MALFORMED, length
    assert rig.books.slots == 0
