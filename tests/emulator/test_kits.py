"""Tests of the kits' emulated firmware, byte by byte, in simulated time."""

import numpy as np
import pytest

from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog, read_slots
from smarttouch.emulator.kajimoto61_firmware import ELECTRODES, Kajimoto61Firmware
from smarttouch.emulator.skin import EmulatedFinger

MS = 1_000_000
SECOND = 1000 * MS


class Rig:
    """Emulated eTactileKit and its delivery log. By default the skin has no parallel load."""

    def __init__(self, folder, outputs=4, **options):
        self.books = DeliveryLog(outputs, folder)
        self.board = ETactileKitFirmware(self.books, **{"dummy_ohm": np.inf} | options)

    def say(self, now_ms, text):
        return self.board.feed(bytes.fromhex(text), int(now_ms * MS))

    def advance(self, now_ms):
        assert self.board.advance(int(now_ms * MS)) == b""
        return self.books.slots

    @property
    def slots(self):
        self.books.write()
        return read_slots(self.books.folder)

    def after(self, now_ms, text):
        """Send bytes at time 0, and advance to ``now_ms``."""
        self.say(0, text)
        self.advance(now_ms)
        return self


@pytest.fixture
def rig(tmp_path):
    return Rig(tmp_path)


@pytest.fixture
def make_rig(tmp_path):
    return lambda *arguments, **options: Rig(tmp_path, *arguments, **options)


EXAMPLE = "FC04 FB00 FD01 FA6400 F732 F63C00 F900 F800 F4"
ONE = "FE 0000 DC00 0000 0000"


def test_its_own_example(rig):
    assert rig.say(0, EXAMPLE) == b"\x04"
    assert rig.say(1, ONE) == b""
    rig.advance(1000)
    assert rig.books.sequences == pytest.approx(60, abs=1)
    slots = rig.slots
    assert set(slots["site"].tolist()) == {1}
    np.testing.assert_allclose(slots["current_ua"][:, 1], -220 * 9.99, atol=1)
    assert (np.delete(slots["current_ua"], 1, axis=1) > 0).all()
    assert rig.books.max_charge_uc == pytest.approx(220 * 9.99e-6 * 100)
    period_us = np.diff(slots["time_us"])
    np.testing.assert_allclose(period_us, 1e6 / 60, atol=2)


def test_it_goes_on_for_ever_without_a_host_and_zeros_end_it(rig):
    rig.say(0, EXAMPLE + ONE)
    rig.board.hang_up(100 * MS)
    rig.advance(10_000)
    assert rig.books.sequences == pytest.approx(600, abs=1)
    assert (rig.books.state, rig.board.busy) == ("driving", True)
    rig.say(10_005, "FE" + "0000" * 4)
    slots = rig.books.slots
    assert rig.advance(11_000) == slots
    assert (rig.books.state, rig.books.reason, rig.board.busy) == ("shorted", "pattern", False)


def test_at_boot_there_is_no_pulse_width_but_a_pulse_and_the_rate_is_100_hz(rig):
    rig.say(0, "FC04" + ONE)
    assert rig.advance(1005) == 100
    assert rig.books.max_charge_uc == pytest.approx(2.1978 * 6.6e-3)
    assert rig.board.busy
    rig.say(1005, "FA6400")
    rig.advance(2005)
    assert rig.books.max_charge_uc == pytest.approx(0.21978)


@pytest.mark.parametrize(("commands", "sites", "apart_us", "own_ua"), [
    # A slot lasts 160 µs, even without a pulse: 100 pulse width, 50 discharge, 10 switching.
    ("FA6400 F732 FE 0A00 0000 0000 0A00", [0, 3], [3 * 160], [-100, -100]),
    ("FA6400 FD00" + ONE, [1], [], [2198]),
    ("FA6400 FD01" + ONE, [1], [], [-2198]),
    # A biphasic pulse consists of two pulses of opposite sign.
    ("FB01 FA6400 F732 FE 6400 6400 0000 0000", [0, 0, 1, 1], [110, 160, 110],
     [-999, 999, -999, 999]),
    # In sense mode every electrode has a pulse, whatever the pattern.
    ("FB02 FA6400 F732 F964 F832" + ONE, [0, 1, 2, 3], [110] * 3, [-999] * 4),
])  # fmt: skip
def test_a_scan(rig, commands, sites, apart_us, own_ua):
    slots = rig.after(15, "FC04" + commands).slots
    assert slots["site"].tolist() == sites
    assert np.diff(slots["time_us"]).tolist() == apart_us
    assert slots["current_ua"][range(len(sites)), sites].tolist() == own_ua
    assert (rig.books.slots, rig.books.sequences) == (len(set(sites)), 1)


def test_readings_are_the_volts_of_the_last_slots(rig):
    rig.say(0, "FC04 F60A00 FA6400 F732" + "FE 0000 6400 0000 C800")
    assert rig.say(10.5, "FF") == bytes(8)
    rig.advance(350)
    volts = np.frombuffer(rig.say(350, "FF"), "<u2") * 0.0893
    slots = rig.slots
    source = [row["volts"].max() - row["volts"].min() for row in slots[-2:]]
    np.testing.assert_allclose(volts, [0, source[0], 0, source[1]], rtol=0.02, atol=0.1)
    rig.say(360, "FE" + "0000" * 4)
    # The pattern is zero, but the next scan has not begun.
    assert rig.say(361, "FF") != bytes(8)
    assert rig.say(705, "FF") == bytes(8)


def test_readings_change_while_a_scan_passes_where_the_parser_does_not_wait(make_rig):
    rig = make_rig(firmware="newest")
    rig.say(0, "FC04 FA6400 F732" + "FE 6400 6400 6400 6400")
    # The scan begins at 10 ms, and its slots take 160 µs: at 10.3 ms, two have begun.
    readings = np.frombuffer(rig.say(10.3, "FF"), "<u2")
    assert (readings > 0).tolist() == [True, True, False, False]


def test_nothing_is_parsed_during_a_scan(rig):
    rig.say(0, "FC04 FAC800 F7C8")
    assert rig.say(10.1, "F5") == b""
    # The scan begins at 10 ms, and its four slots take 410 µs each.
    assert rig.board.advance(int(11.6 * MS)) == b""
    assert rig.board.advance(int(11.7 * MS)) == b"\x01"


def test_the_newest_stops_half_a_second_after_its_host(make_rig):
    rig = make_rig(firmware="newest")
    rig.say(0, EXAMPLE + ONE + "FA")
    assert rig.advance(495) > 0
    slots = rig.advance(505)
    assert (rig.books.state, rig.books.reason) == ("shorted", "silence")
    assert rig.advance(2000) == slots
    # The incomplete command was discarded, but the number of electrodes was kept.
    assert rig.say(2000, "F4") == b"\x04"


def test_half_a_command_is_forgotten_after_2_s_with_all_that_waits(rig):
    rig.say(0, EXAMPLE)
    assert rig.say(100, "FE 0000 DC00 00") == b""
    # Until the command is 2 s old, the firmware treats each byte as part of its pattern.
    assert rig.say(2099, "F4") == b""
    assert rig.say(2101, "F4") == b"\x04"
    assert rig.books.slots == 0


def test_a_lost_byte_means_another_current(rig):
    rig.say(0, EXAMPLE)
    # A byte of the pattern is lost: 0xDC becomes a high byte. The next FE completes the pattern.
    rig.say(1, "FE 00 DC00 0000 0000" + "FE")
    rig.advance(100)
    assert rig.books.unsafe > 0
    assert rig.books.max_current_ma > 5


def test_heights_are_cut_at_4095(rig):
    rig.after(15, "FC04 FA0A00 FE 0000 FFFF 0000 0000")
    # The pattern requests 41 mA, but the compliance voltage allows less.
    assert rig.books.max_current_ma > 20
    assert rig.books.max_volts == pytest.approx(300)
    rig = Rig(None, compliance_v=1e4)
    rig.after(15, "FC04 FA0A00 FE 0000 FFFF 0000 0000")
    assert rig.books.max_current_ma == pytest.approx(4095 * 9.99e-3)


def test_too_much_for_the_period_stops_the_parser_for_good(rig):
    rig.after(1000, "FC04 FAC800 F7FF F6F401 FE" + "0A00" * 4)
    # Four slots of 465 µs fit in a period of 2 ms, but not in one of 1 ms.
    assert rig.books.sequences == pytest.approx(499, abs=1)
    rig.say(1000, "F6E803")
    rig.advance(2000)
    assert rig.say(2000, "F60A00 FC00" + "FE00000000" * 3 + "F5 F4") == b""
    slots = rig.books.slots
    assert rig.advance(3_000) > slots


def test_the_newest_parses_beside_a_scan_that_never_ends(make_rig):
    rig = make_rig(firmware="newest")
    rig.after(100, "FC04 FAC800 F7FF F6E803" + "FE" + "0A00" * 4)
    assert rig.say(100, "FE" + "0000" * 4 + "F4") == b"\x04"
    slots = rig.advance(103)
    assert rig.advance(200) == slots


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
    """Return an emulated kajimoto61 after its self-test; its converter stores no current."""
    board = Kajimoto61Firmware(books)
    assert board.feed(ZERO, 0) == b""
    board._loaded_ua = 0.0
    return board


def play(board, *steps):
    """Execute steps on a board: bytes are fed, and a number is the new time in ms."""
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
    """Anodic pulses return through all other electrodes. A packet waits for the end of the scan."""
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
    # The first byte of the next packet completes the short packet. The firmware skips the rest.
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
    # The first pulse begins with 3 µs of 2192 µA, which the self-test left. Zeros do not clear it.
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
    # 300 V are 3,359 counts. Shifted right by 2 bits they are 839, and 839 - 3 * 256 = 71.
    assert reply[5] == 71
    assert reply[6] < 10
    assert reply[-1] == 0xFF not in reply[:-1]


@pytest.mark.parametrize(("value", "unsafe"), [(1, 0), (128, 0), (129, 1), (200, 1), (201, 0)])
def test_from_129_on_a_byte_is_more_than_5_ma(board, books, value, unsafe):
    play(board, 0, frame(e30=value), 1)
    assert books.unsafe == unsafe
    assert books.max_current_ma <= 7.8126
