"""Whatever eTactileKit is there, in whatever state: it is identified, and put at zero first."""

import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError, SilentBoardError
from smarttouch.boards.kits import etactilekit_line
from smarttouch.boards.kits.etactilekit import ETactileKitBoard
from smarttouch.boards.reports import HostStatistics
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_firmware import LinkFirmware
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.manual_kit import ManualClock, ManualPort

from ..raising import raises

LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
# Left by hosts before: pulses of a milliampere on all electrodes, sense pulses, half commands.
PULSING = {
    "v1.0": "FC08 FB19 FA64 F732 F632 FE 0101010101010101",
    "936c6c0": "FC08 FB6400 FA6400 F732 F63200 FE 0101010101010101",
    "71adee2": "FC08 FA6400 F732 F63200 FE" + "6400" * 8,
    "newest": "FC08 FA6400 F732 F63200 FE" + "6400" * 8,
}
SENSE = "F919 F832"
HALVES = ["", "FE", "FE 01", "FE 010101", "FB", "FA", "FA FF", "FD", "FC", "F9", "F6", "FB 64"]
HALF = st.sampled_from(HALVES)


class Meeting:
    """A driver that meets a board for the first time."""

    def __init__(self, patch, firmware, option="", board=None):
        self.clock = ManualClock(late_us=0)
        patch.setattr(etactilekit_line.time, "sleep", self.clock.sleep)
        patch.setattr(etactilekit_line.time, "monotonic", self.clock.monotonic)
        self.books = DeliveryLog(8)
        self.board = board or ETactileKitFirmware(self.books, firmware=firmware)
        self.port = ManualPort(self.board, self.clock)
        patch.setattr(etactilekit_line, "open_port", lambda _: self.port)
        patch.setattr("smarttouch.boards.kits.kept_line.KeptLine", lambda port: port)
        self.driver = ETactileKitBoard("told" + option, LIMITS)
        self.driver._clock, self.driver._pause = self.clock, self.clock.sleep
        self.driver._serial = self.port
        self.driver._books = HostStatistics(8)

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


@pytest.mark.parametrize("firmware", ["936c6c0", "71adee2", "newest"])
def test_each_is_distinguished(meet, firmware):
    meeting = meet(firmware)
    meeting.driver._greet()
    can = meeting.driver.capabilities
    assert firmware in can.firmware
    assert (can.time_to_zero_ms is None) == (firmware != "newest")
    assert meeting.books.slots == 0


@pytest.mark.parametrize("firmware", ["936c6c0", "71adee2", "newest"])
@pytest.mark.parametrize("half", HALVES)
def test_a_board_that_pulses_is_at_zero_and_its_parser_found(meet, firmware, half):
    meeting = meet(firmware)
    meeting.leave(PULSING[firmware] + SENSE + half)
    pulsed = meeting.books.slots
    assert pulsed > 0
    meeting.driver._greet()
    assert firmware in meeting.driver.capabilities.firmware
    slots = meeting.slots_at_rest()
    assert meeting.books.state == "shorted"
    # At most the scan that was under way, and one with what zeros made of half a command.
    assert slots - pulsed <= 24
    # 0x101 counts: what the host before had begun to ask for.
    assert meeting.books.max_current_ma <= 2.57


@pytest.mark.parametrize("half", HALVES)
def test_the_first_firmware_is_put_at_zero_and_refused(meet, half):
    meeting = meet("v1.0")
    meeting.leave(PULSING["v1.0"] + SENSE + half)
    with raises(BoardError, about="firmware", value="v1.0"):
        meeting.driver._greet()
    meeting.slots_at_rest()


@settings(max_examples=100, deadline=None)
@given(
    firmware=st.sampled_from(sorted(PULSING)),
    noise=st.binary(max_size=12),
    half=HALF,
    losses=st.lists(st.integers(0, 700), max_size=1),
)
def test_no_probe_ever_makes_a_board_pulse(firmware, noise, half, losses):
    """Not even one of whose bytes one is lost, or behind noise: a quiet board stays quiet."""
    with pytest.MonkeyPatch.context() as patch:
        meeting = Meeting(patch, firmware)
        # Everything set but a height.
        quiet = "FC08 FA6400 F732 F632" + "FB0000" * (firmware == "936c6c0")
        meeting.leave(quiet + (half or bytes(min(each, 0xF3) for each in noise).hex()))
        before = meeting.books.max_charge_uc, meeting.books.slots
        write, count = meeting.port.write, [0]

        def lossy(data):
            kept = bytes(b for i, b in enumerate(data, count[0]) if i not in losses)
            count[0] += len(data)
            write(kept)
            return len(data)

        meeting.port.write = lossy
        with contextlib.suppress(BoardError):
            meeting.driver._greet()
        meeting.board.advance(meeting.clock.time_ns + 100_000_000)
        assert (meeting.books.max_charge_uc, meeting.books.slots) == before


@pytest.mark.parametrize("other", ["kajimoto61", "link", "silent"])
def test_another_board_gets_nothing_that_it_could_obey(meet, other):
    books = DeliveryLog(61 if other == "kajimoto61" else 8)
    board = {
        "kajimoto61": lambda: Kajimoto61Firmware(books),
        "link": lambda: LinkFirmware(8, "one-against-all", books),
        "silent": lambda: Deaf(books),
    }[other]()
    meeting = meet("71adee2", board=board)
    with raises(SilentBoardError, about="board"):
        meeting.driver._greet()
    assert (books.slots, books.sequences) == (0, 0)
    assert 0xFF not in meeting.port.said
    assert 0xFE not in meeting.port.said


class Deaf(ETactileKitFirmware):
    def feed(self, data, now_ns):
        return b""


@pytest.mark.parametrize(("firmware", "option", "is_one"), [
    ("71adee2", "?firmware=71adee2", True), ("newest", "?firmware=newest", True),
    ("936c6c0", "?slow&firmware=936c6c0", True), ("71adee2", "?firmware=936c6c0", False),
    ("936c6c0", "?firmware=newest", False),
])  # fmt: skip
def test_a_user_may_name_it(meet, firmware, option, is_one):
    meeting = meet(firmware, option)
    if not is_one:
        with raises(BoardError, about="?firmware", allowed=firmware):
            meeting.driver._greet()
        return
    meeting.driver._greet()
    assert firmware in meeting.driver.capabilities.firmware
    assert (meeting.driver.capabilities.time_to_zero_ms is None) == (firmware != "newest")


@pytest.mark.parametrize(("option", "about", "value"), [
    ("?fast", "option", "fast"), ("?firmware=2", "?firmware", "2"), ("?slow&&x", "option", ""),
])  # fmt: skip
def test_an_unknown_option_is_named(option, about, value):
    with raises(BoardError, about=about, value=value):
        ETactileKitBoard("x" + option, LIMITS)


def test_a_smaller_kit_than_the_profile_is_refused(meet):
    meeting = meet("71adee2")
    meeting.driver._outputs = 32
    with raises(BoardError, about="electrodes", value=32, allowed=8):
        meeting.driver._greet()
