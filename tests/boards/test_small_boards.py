"""Boards that hold few slots and short packets get a scan in parts, and deliver it whole."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import BoardError
from smarttouch.boards.link.sequence_encoding import KernelImage, encode_scan
from smarttouch.emulator.emulated_boards import SimulatedBoard
from smarttouch.emulator.firmware import read_slots
from smarttouch.emulator.link_packets import KernelStore, decode_lists
from smarttouch.emulator.link_rules import _filled_in
from smarttouch.emulator.rules_over_time import Room
from smarttouch.profile import load_profile
from smarttouch.stimulation.scan_sequence import KernelLists, ScanSequence
from tests.boards.fresh import deliver, fresh_state
from tests.boards.test_contract import AT_ANY_LINE, DELIVERED, SENT, Contract, without_repeating
from tests.firmware.build import host
from tests.firmware.scenes import random_table, sequence_of

from ..raising import raises
from ..whole import WHOLE

PROFILES = {"line-7": 7, "line-8": 8, "smarttouch-4x4": 16, "electric-mouse": 64,
            "optacon-24x6": 144}  # fmt: skip
"""Shipped profiles of link boards, with their electrodes."""


def flags(electrodes):
    """Return what the C core is compiled with for the smallest packets that a board may take."""
    packet = max(128, 64 + 8 * electrodes)
    sizes = {"MOST_SLOTS": 4, "PACKET_BYTES": packet, "KERNEL_BYTES": 600, "MOST_KERNELS": 9}
    return " ".join(f"-DST_{name}={size}u" for name, size in sizes.items())


@pytest.mark.usefixtures("patient_boards")
class SmallContract(Contract):
    # A recharge phase and four slots are more than a packet, and repeated.
    shows_recharges = False
    instants = 2

    def test_a_scan_in_parts_is_one_sequence(self, make_board):
        recharged = replace(self.sequence(2), recharge_us=500, recharge_ua=np.zeros(8, np.int16))
        long = self.sequence(1, sites=[*range(8), 3, 5, 0])
        with make_board() as board:
            deliver(board, self.sequence(0))
            number = board.send(long)
            deliver(board, recharged)
            assert (board.acknowledged, board.refused) == (3, 0)
            assert board.start_of(number) is not None
            report = board.report()
            (volts,) = (volts for each, volts in board.take_volts() if each.slots == long.slots)
            with raises(BoardError):
                board.send(self.sequence(3, sites=range(8)), times=2)
        assert (report.sequences, report.slots, report.violations) == (3, 11 + 4, 0)
        assert len(volts) == long.slots
        slots = read_slots(self.folder)
        np.testing.assert_array_equal(slots["current_ua"][:11], long.current_ua)
        np.testing.assert_array_equal(slots["site"][:11], long.site)
        starts_us = slots["time_us"][:11]
        assert np.diff(starts_us).min() >= self.width_us + self.discharge_us
        assert len(set(slots["number"][:11])) == 3


PARTS = "test_a_scan_in_parts_is_one_sequence", DELIVERED, SENT


@without_repeating(*PARTS, AT_ANY_LINE)
class TestSmallEmulator(SmallContract):
    @pytest.fixture
    def url(self, start_emulator, tmp_path):
        def url(kind):
            self.folder = Path(tempfile.mkdtemp(dir=tmp_path))
            options = (f"--books={self.folder}", "--slots=4", "--packet=128")
            return "link:" + start_emulator(*options, output=kind)[1]

        return url


@without_repeating(*PARTS)
class TestSmallFirmware(SmallContract):
    @pytest.fixture
    def url(self, start_firmware, tmp_path):
        def url(kind):
            self.folder = Path(tempfile.mkdtemp(dir=tmp_path))
            options = (f"--books={self.folder}", "--ramp-ms=0")
            return "link:" + start_firmware(*options, output=kind, built=host(flags(8)))[1]

        return url


@pytest.mark.wall_clock
@pytest.mark.usefixtures("patient_boards")
@pytest.mark.parametrize("name", PROFILES if WHOLE else ["electric-mouse"])
def test_shipped_profiles_run_on_boards_of_four_slots(start_firmware, tmp_path, name):
    profile, electrodes = load_profile(name), PROFILES[name]
    port = start_firmware(
        f"--books={tmp_path}", electrodes=electrodes, output=profile.output.kind,
        built=host(flags(electrodes)),
    )[1]  # fmt: skip
    with st.open_display(f"link:{port}", profile) as display:
        scans, given = [], {"intensity": 0.6, "seconds": 1.5, "force": "fixed:0.9"}
        st.run("text:WWW", display, listeners=[lambda step: scans.append(step.sequence)], **given)
    state = fresh_state(tmp_path)
    assert (state["violations"], state["unsafe"]) == (0, 0)
    numbers, slots = np.unique(read_slots(tmp_path)["number"], return_counts=True)
    assert slots.max() <= 4
    # The last may be cut by the end of the run.
    sent = [scan.slots for scan in scans]
    assert sum(sent[:-1]) <= state["slots"] <= sum(sent)
    assert len(numbers) >= sum(-(-count // 4) for count in sent[:-1]) > 0
    assert electrodes < 16 or max(sent) > 4


class SmallSimulated(SimulatedBoard):
    room = Room(4, 128, 300, 5)


@pytest.mark.parametrize("seed", range(3))
def test_what_a_small_board_delivers_is_what_a_large_one_does(make_limits, seed):
    """To the bit and the microsecond, kernels and currents mixed."""
    rng = np.random.default_rng(seed)
    table, found = random_table(rng, 12, 8), []
    scans = [_scan(rng, table, step) for step in range(1, 16)]
    for kind in (SimulatedBoard, SmallSimulated):
        board = kind("", make_limits())
        with board:
            board.keep_kernels(table)
            board.send(replace(_cut_to(scans[0], 0), time_ns=0, intensity=0))
            for scan in scans:
                board.send(scan)
            volts = [volts.tolist() for _, volts in board.take_volts()]
            report = board.report()
        found.append((volts, report, *(each.tolist() for each in board.take_pulses()[1:])))
    assert found[0] == found[1]
    assert found[0][1].slots == sum(scan.slots for scan in scans)


def _scan(rng, table, step):
    count = int(rng.integers(1, 12))
    size = rng.integers(1, 4, count)
    first = np.concatenate([[0], size.cumsum()])
    kernel = rng.integers(0, len(table.weights), first[-1]).astype(np.uint16)
    lists = KernelLists(table, first, kernel, rng.integers(0, 400, first[-1]).astype(np.uint16))
    scan = sequence_of(lists, time_ns=step * 10**9, intensity=1.0, period_us=20_000)
    if step % 3 == 0:
        width_us = rng.choice([60, 100, 200], count).astype(np.uint16)
        scan = replace(scan, sums=None, width_us=width_us)
    if step % 4 == 0:
        return replace(scan, recharge_us=200, recharge_ua=np.zeros(8, np.int16))
    return scan


def _cut_to(scan, slots):
    fields = ("current_ua", "width_us", "discharge_us", "site")
    return replace(scan, sums=None, **{name: getattr(scan, name)[:slots] for name in fields})


@pytest.mark.parametrize("seed", range(20))
def test_parts_are_small_enough_and_make_up_the_scan(seed):
    rng = np.random.default_rng(seed)
    table = random_table(rng, 12, 8)
    image, scan = KernelImage.of(table, 300, 5), _scan(rng, table, seed)
    most_slots, most_bytes = int(rng.integers(1, 6)), int(rng.choice([56, 101, 300]))
    parts = encode_scan(scan, 1, False, False, image, most_bytes, most_slots)
    at = 0
    for part in parts:
        assert len(part.payload) <= most_bytes
        assert part.slots <= most_slots
        lists = decode_lists(part.payload, 8, False)
        assert (lists.goes_on, lists.more) == (at > 0, part is not parts[-1])
        assert (part.first, lists.slots) == (at, part.slots)
        assert (lists.sequence.recharge_ua is not None) == (
            scan.recharge_ua is not None and not lists.more
        )
        rows = slice(at, at + part.slots)
        keep = KernelStore(8, 300, 5)
        keep.take(image.identity, len(image.data), 0, image.data)
        kind = np.repeat([group.kind for group in lists.groups], [g.slots for g in lists.groups])
        assert not _filled_in(lists, keep, kind < 2).any()
        np.testing.assert_array_equal(lists.sequence.current_ua, scan.current_ua[rows])
        np.testing.assert_array_equal(lists.sequence.width_us, scan.width_us[rows])
        at += part.slots
    assert at == scan.slots


@pytest.mark.parametrize("slots", [0, 1, 3])
def test_a_slot_that_no_packet_holds_is_refused_by_its_size(slots):
    rows = np.zeros((slots, 8), np.int16)
    column = np.ones(slots, np.uint16)
    recharge = (np.zeros(8, np.int16), 500) if not slots else (None, 0)
    scan = ScanSequence(
        rows, 100 * column, 50 * column, 0 * column, 10_000, 0.5, 0,
        recharge_ua=recharge[0], recharge_us=recharge[1],
    )  # fmt: skip
    with raises(BoardError, value="20"):
        encode_scan(scan, 1, False, False, None, 20, 4)
