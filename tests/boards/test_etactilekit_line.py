"""Whatever eTactileKit is there, in whatever state: it is identified, and put at zero first."""

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError, SilentBoardError
from smarttouch.boards.kits.etactilekit import ETactileKitDriver
from smarttouch.boards.open import make_driver
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.manual_kit import ManualClock, ManualPort, manual_line

from ..raising import raises
from ..whole import WHOLE, sample

LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
# Left by hosts before: pulses of a milliampere on all electrodes, sense pulses, half commands.
PULSING = {
    "71adee2": "FC08 FA6400 F732 F63200 FE" + "6400" * 8,
    "newest": "FC08 FA6400 F732 F63200 FE" + "6400" * 8,
}
SENSE = "F919 F832"
HALVES = ["", "FE", "FE 01", "FE 010101", "FB", "FA", "FA FF", "FD", "FC", "F9", "F6", "FB 64"]
HALF = st.sampled_from(HALVES)
OLD = {
    "v1.0": (1, "FC08 FB19 FA64 F732 F632 FE 0101010101010101"),
    "936c6c0": (2, "FC08 FB6400 FA6400 F732 F63200 FE 0101010101010101"),
}
"""Older firmwares: bytes of a height, a width and a rate, and what makes all electrodes pulse."""


class OldKit:
    """Parser of an older firmware, which knows no F4: half a command waits for ever, and an FE for
    no electrodes ends it for good."""

    def __init__(self, books, size):
        self.books, self.sizes = books, dict.fromkeys(range(0xF6, 0xFE), 1)
        self.sizes |= dict.fromkeys((0xFB, 0xFA, 0xF6), size)
        self.set, self.codes, self.received = dict.fromkeys(self.sizes, 0), b"", bytearray()
        self.scanned_ns = 0

    def pulses(self):
        sense, height = self.set[0xF9], self.set[0xFB]
        return sum((height if each in (1, 2) else sense) > 0 for each in self.codes)

    def advance(self, now_ns):
        scans, self.scanned_ns = (now_ns - self.scanned_ns) // 20_000_000, now_ns
        self.books.slots += scans * self.pulses()
        return b""

    def feed(self, data, now_ns):
        self.advance(now_ns)
        self.received += data
        answers = b""
        while self.received:
            code, count = self.received[0], self.set[0xFC]
            size = count if code == 0xFE else self.sizes.get(code, 0)
            if len(self.received) <= size or (code, size) == (0xFE, 0):
                break
            value = bytes(self.received[1 : 1 + size])
            del self.received[: 1 + size]
            if code == 0xF5:
                answers += b"\x01"
            elif code == 0xFF:
                answers += bytes(2 * count)
            elif code == 0xFE:
                self.codes = value
            elif code in self.sizes:
                self.set[code] = int.from_bytes(value, "little")
            self.codes = self.codes[: self.set[0xFC]]
        return answers


class Meeting:
    """A driver that meets a board for the first time."""

    def __init__(self, patch, firmware, selected=None, board=None):
        self.clock = ManualClock(late_us=0)
        self.books = DeliveryLog(8)
        self.board = board or ETactileKitFirmware(self.books, firmware=firmware)
        self.port = ManualPort(self.board, self.clock)
        self.driver = ETactileKitDriver("told", LIMITS, firmware=selected)
        self.line = manual_line(patch, self.driver, self.port, self.clock, LIMITS)

    def open(self):
        """Return the capabilities of the board that is opened."""
        return self.driver.open(self.line, LIMITS)

    def leave(self, text):
        self.clock.time_ns += 5_000_000
        self.board.feed(bytes.fromhex(text), self.clock.time_ns)
        self.clock.time_ns += 100_000_000
        self.board.advance(self.clock.time_ns)

    def slots_at_rest(self):
        """Check that nothing flows for three seconds; return how many slots have."""
        slots = self.books.slots
        self.board.advance(self.clock.time_ns + 3_000_000_000)
        assert self.books.slots == slots
        return slots


@pytest.fixture
def meet(monkeypatch):
    return lambda *arguments, **more: Meeting(monkeypatch, *arguments, **more)


@pytest.mark.parametrize(
    ("firmware", "selected"),
    [("71adee2", None), ("newest", None), ("71adee2", "71adee2"), ("newest", "newest")],
)
def test_each_is_distinguished_or_named(meet, firmware, selected):
    meeting = meet(firmware, selected)
    can = meeting.open()
    assert firmware in can.firmware
    assert (can.time_to_zero_ms is None) == (firmware != "newest")
    assert meeting.books.slots == 0


@pytest.mark.parametrize("firmware", ["71adee2", "newest"])
@pytest.mark.parametrize("half", HALVES)
def test_a_board_that_pulses_is_at_zero_and_its_parser_found(meet, firmware, half):
    meeting = meet(firmware)
    meeting.leave(PULSING[firmware] + SENSE + half)
    pulsed = meeting.books.slots
    assert pulsed > 0
    assert firmware in meeting.open().firmware
    slots = meeting.slots_at_rest()
    assert meeting.books.state == "shorted"
    # At most the scan that was under way, and one with what zeros made of half a command.
    assert slots - pulsed <= 24
    # 0x101 counts: what the host before had begun to ask for.
    assert meeting.books.max_current_ma <= 2.57


@pytest.mark.parametrize("half", sample(HALVES))
@pytest.mark.parametrize("firmware", OLD)
def test_an_older_firmware_is_put_at_zero_and_refused(meet, firmware, half):
    size, pulsing = OLD[firmware]
    meeting = meet(None, board=OldKit(DeliveryLog(8), size))
    meeting.leave(pulsing + SENSE + half)
    assert meeting.board.books.slots > 0
    with raises(BoardError, names="firmware", value="71adee2"):
        meeting.open()
    assert meeting.board.pulses() == 0
    assert meeting.board.set[0xFC] == 0


@settings(max_examples=100 if WHOLE else 25, deadline=None)
@given(
    firmware=st.sampled_from([*PULSING, *OLD]),
    noise=st.binary(max_size=12),
    half=HALF,
    losses=st.lists(st.integers(0, 700), max_size=1),
)
def test_no_probe_ever_makes_a_board_pulse(firmware, noise, half, losses):
    """Not even one of whose bytes one is lost, or behind noise: a quiet board stays quiet."""
    with pytest.MonkeyPatch.context() as patch:
        old = OldKit(DeliveryLog(8), OLD[firmware][0]) if firmware in OLD else None
        meeting = Meeting(patch, firmware if old is None else None, board=old)
        # Everything set but a height.
        quiet = "FC08 FA6400 F732 F632" + "FB0000" * (firmware == "936c6c0")
        meeting.leave(quiet + (half or bytes(min(each, 0xF3) for each in noise).hex()))
        books = meeting.books if old is None else old.books
        before = books.max_charge_uc, books.slots
        write, count = meeting.port.write, [0]

        def lossy(data):
            kept = bytes(b for i, b in enumerate(data, count[0]) if i not in losses)
            count[0] += len(data)
            write(kept)
            return len(data)

        meeting.port.write = lossy
        with contextlib.suppress(BoardError):
            meeting.open()
        meeting.board.advance(meeting.clock.time_ns + 100_000_000)
        assert (books.max_charge_uc, books.slots) == before


@pytest.mark.parametrize("other", ["kajimoto61", "link", "silent"])
def test_another_board_gets_nothing_that_it_could_obey(meet, other):
    books = DeliveryLog(61 if other == "kajimoto61" else 8)
    board = {
        "kajimoto61": lambda: Kajimoto61Firmware(books),
        "link": lambda: LinkFirmware("one-against-all", books),
        "silent": lambda: Deaf(books),
    }[other]()
    meeting = meet("71adee2", board=board)
    with raises(SilentBoardError, names="board"):
        meeting.open()
    assert (books.slots, books.sequences) == (0, 0)
    assert 0xFF not in meeting.port.said
    assert 0xFE not in meeting.port.said


class Deaf(ETactileKitFirmware):
    def feed(self, data, now_ns):
        return b""


@pytest.mark.parametrize(
    ("option", "about", "value"), [("fast=1", "option", "fast"), ("firmware=2", "?firmware", "2")]
)
def test_an_unknown_option_is_named(option, about, value):
    with raises(BoardError, names=about, value=value):
        make_driver(f"etactilekit:x?{option}", LIMITS)


def test_a_smaller_kit_than_the_profile_is_refused(meet):
    meeting = meet("71adee2")
    limits = SafetyLimits(32, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
    with raises(BoardError, value=32, allowed=8):
        ETactileKitDriver("told", limits).open(meeting.line, limits)
