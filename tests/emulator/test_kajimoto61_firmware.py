"""The kit of 61 electrodes, to the byte, on a clock of the test's own."""

import numpy as np
import pytest

from smarttouch.emulator.firmware import DeliveryLog, read_slots
from smarttouch.emulator.kajimoto61_firmware import ELECTRODES, Kajimoto61Firmware
from smarttouch.emulator.skin import EmulatedFinger

MS = 1_000_000
ZERO = b"\xff" + bytes(ELECTRODES)


def frame(**intensities):
    data = bytearray(ZERO)
    for electrode, value in intensities.items():
        data[1 + int(electrode[1:])] = value
    return bytes(data)


@pytest.fixture
def books(tmp_path):
    return DeliveryLog(ELECTRODES, tmp_path)


@pytest.fixture
def board(books):
    """A board whose self-test is over, and what it left in the converter."""
    board = Kajimoto61Firmware(books)
    assert board.feed(ZERO, 0) == b""
    board._loaded_ua = 0.0
    return board


def play(board, *steps):
    """Let times come, in milliseconds, and bytes at them."""
    now_ns = 0
    for step in steps:
        if isinstance(step, bytes):
            board.feed(step, now_ns)
        else:
            now_ns = int(step * MS)
            board.advance(now_ns)


def delivered(books):
    books.write()
    return read_slots(books.folder)


def test_electrodes_come_in_order_and_only_those_that_are_on(board, books):
    """Anodic, with all others as the return; a packet that comes early waits."""
    play(board, 0, frame(e60=10, e2=20, e5=0, e9=201, e10=255, e11=200) + frame(e0=50), 10)
    slots = delivered(books)
    assert (slots["site"][3], slots["time_us"][3], books.sequences) == (0, 3 * 208, 3)
    own_ua = slots["current_ua"][range(4), slots["site"]]
    assert own_ua.tolist() == [-round(39.0625 * each) for each in (20, 200, 10, 50)]
    assert np.abs(slots["current_ua"].sum(axis=1)).max() <= 30
    slots = slots[:3]
    assert slots["site"].tolist() == [2, 11, 60]
    assert slots["time_us"].tolist() == [0, 208, 416]
    assert slots["slot"].tolist() == [0, 1, 2]


def test_a_short_packet_waits_for_ever_and_zeros_are_the_way_out(board, books):
    play(board, 0, frame(e60=50)[:-1], 3_600_000)
    board.hang_up(3_600_000 * MS)
    assert books.slots == 0
    # The next packet's first byte completes it, and the rest is ignored.
    play(board, 3_600_001, frame(e0=50)[:1] + bytes(30), 3_600_010)
    assert books.slots == 0
    play(board, 3_600_011, frame(e0=50), 3_600_012)
    assert books.slots == 1
    play(board, 3_600_013, b"\xff\x01", 3_600_014, bytes(61), 3_600_020, 3_600_030, ZERO)
    assert books.slots == 2
    play(board, 3_600_040, frame(e1=50), 3_600_050)
    assert books.slots == 3


@pytest.mark.parametrize("junk", [b"\x00", bytes(range(254)), b"\xfd" * 1000])
def test_other_bytes_are_ignored(board, books, junk):
    play(board, 0, junk + frame(e7=50), 5)
    assert (books.slots, delivered(books)["site"].tolist()) == (1, [7])


def test_in_the_self_test_it_measures_and_any_first_packet_stimulates():
    books = DeliveryLog(ELECTRODES)
    board = Kajimoto61Firmware(books)
    assert books.state == "self-test"
    board.feed(b"\xfe", 1 * MS)
    assert len(board.advance(100 * MS)) == 62
    assert (books.slots, books.state) == (61, "self-test")
    play(board, 101, frame(e1=50), 110)
    assert (books.slots, books.state) == (62, "shorted")


@pytest.mark.parametrize("first", [b"", ZERO, ZERO * 3])
def test_what_the_self_test_left_flows_for_a_moment_in_the_first_pulse(tmp_path, first):
    books = DeliveryLog(ELECTRODES, tmp_path)
    board = Kajimoto61Firmware(books)
    play(board, 0, first, 10, frame(e1=1, e2=1), 20, frame(e1=1), 30)
    slots = delivered(books)
    assert slots["site"].tolist() == [1, 1, 2, 1]
    # 898 counts for 3 µs, then its own value: no zero packet loads anything.
    own = -slots["current_ua"][range(4), slots["site"]]
    assert own.tolist() == [2192, 39, 39, 39]
    charge = np.abs(slots["charge_uc"]).max(axis=1)
    assert charge[0] == pytest.approx(2.192e-3 * 3, rel=1e-2)
    assert (books.slots, books.unsafe) == (3, 0)


def test_a_reading_wraps_and_never_looks_like_the_end():
    board = Kajimoto61Firmware(
        DeliveryLog(ELECTRODES), EmulatedFinger(ELECTRODES, ["0 open 5", "0 short 6"])
    )
    play(board, 0, ZERO, 1, b"\xfe")
    reply = board.advance(10 * MS)
    # 300 V are 3,359 counts, 839 after the shift, and 839 - 3 * 256 = 71 in a byte.
    assert reply[5] == 71
    assert reply[6] < 10
    assert reply[-1] == 0xFF not in reply[:-1]


@pytest.mark.parametrize(("value", "unsafe"), [(1, 0), (128, 0), (129, 1), (200, 1), (201, 0)])
def test_from_129_on_a_byte_is_more_than_5_ma(board, books, value, unsafe):
    play(board, 0, frame(e30=value), 1)
    assert books.unsafe == unsafe
    assert books.max_current_ma <= 7.8126
