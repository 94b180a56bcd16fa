"""A scan in parts, for a board that holds few slots and short packets, is the same scan."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.boards.link.sequence_encoding import KernelImage, encode_scan
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.emulator.link_packets import decode_lists
from smarttouch.emulator.link_rules import Room
from smarttouch.stimulation.scan_sequence import KernelLists, ScanSequence
from tests.firmware.scenes import random_table, sequence_of

from ..raising import raises


class SmallDriver(SimulatedDriver):
    room = Room(4, 128, 300, 5)


def made_scan(rng, table, step):
    """Return a scan of 1 to 11 slots: of kernels, of currents, or with a recharge phase."""
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


@pytest.mark.parametrize("seed", range(3))
def test_what_a_small_board_delivers_is_what_a_large_one_does(make_limits, seed):
    """To the bit and the microsecond, kernels and currents mixed."""
    rng = np.random.default_rng(seed)
    table, found = random_table(rng, 12, 8), []
    scans = [made_scan(rng, table, step) for step in range(1, 16)]
    fields = ("current_ua", "width_us", "discharge_us", "site")
    none = {name: getattr(scans[0], name)[:0] for name in fields}
    for kind in (SimulatedDriver, SmallDriver):
        limits = make_limits()
        with Board(kind("", limits), limits, on_a_finger=False, claimed_time=True) as board:
            board.keep_kernels(table)
            board.send(replace(scans[0], sums=None, time_ns=0, intensity=0, **none))
            numbers = [board.send(scan) for scan in scans]
            volts = [volts.tolist() for _, volts in board.take_volts()]
            report = board.report()
            assert all(board.start_of(number) is not None for number in numbers)
            if kind is SmallDriver:
                longest = max(scans, key=lambda scan: scan.slots)
                with raises(BoardError):
                    board.send(replace(longest, time_ns=20 * 10**9), times=2)
        found.append((volts, report, *(each.tolist() for each in board.driver.take_pulses()[1:])))
    assert found[0] == found[1]
    assert found[0][1].slots == sum(scan.slots for scan in scans)


@pytest.mark.parametrize("seed", range(20))
def test_parts_are_small_enough_and_make_up_the_scan(seed):
    rng = np.random.default_rng(seed)
    table = random_table(rng, 12, 8)
    image, scan = KernelImage.of(table, 300, 5), made_scan(rng, table, seed)
    most_slots, most_bytes = int(rng.integers(1, 6)), int(rng.choice([70, 101, 300]))
    parts = encode_scan(scan, 1, False, False, image, most_bytes, most_slots)
    at = 0
    for part in parts:
        assert len(part.payload) <= most_bytes
        assert part.slots <= most_slots
        lists = decode_lists(part.payload, 8, False)
        assert (lists.goes_on, lists.more) == (at > 0, part is not parts[-1])
        assert (part.first, lists.slots) == (at, part.slots)
        assert (lists.recharge_ua is not None) == (scan.recharge_ua is not None and not lists.more)
        np.testing.assert_array_equal(lists.width_us, scan.width_us[at:][: part.slots])
        at += part.slots
    assert at == scan.slots


@pytest.mark.parametrize("slots", [0, 1, 3])
def test_a_slot_that_no_packet_holds_is_refused_by_its_size(slots):
    column = np.ones(slots, np.uint16)
    recharge = (np.zeros(8, np.int16), 500) if not slots else (None, 0)
    scan = ScanSequence(
        np.zeros((slots, 8), np.int16), 100 * column, 50 * column, 0 * column, 10_000, 0.5, 0,
        recharge_ua=recharge[0], recharge_us=recharge[1],
    )  # fmt: skip
    with raises(BoardError, value="20"):
        encode_scan(scan, 1, False, False, None, 20, 4)
