"""The exact bytes that the driver of an eTactileKit writes: on opening, for patterns, and for zero
in any state. And the driver's estimate of scan times (`ScanLock`)."""

import contextlib
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError, SilentBoardError
from smarttouch.boards.kits.etactilekit import ETactileKitDriver, ScanLock
from smarttouch.boards.kits.etactilekit_protocol import (
    GO,
    LOAD,
    PING,
    QUIET,
    READINGS,
    ZEROS,
    Settings,
    Span,
    zero_anywhere,
)
from smarttouch.boards.open import make_board
from smarttouch.emulator.etactilekit_firmware import FIRMWARES, ETactileKitFirmware
from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.simulated_time_kit import ManualKit

from ..support.checks import raises
from ..support.full import WHOLE, sample
from ..support.scans import one_each

LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
# An earlier program left pulses of 1 mA on all electrodes, sense pulses, and half a command.
PULSING = "FC08 FA6400 F732 F63200 FE" + "6400" * 8
SENSE = "F919 F832"
HALVES = ["", "FE", "FE 01", "FE 010101", "FB", "FA", "FA FF", "FD", "FC", "F9", "F6", "FB 64"]
HALF = st.sampled_from(HALVES)
OLD = {
    "v1.0": (1, "FC08 FB19 FA64 F732 F632 FE 0101010101010101"),
    "936c6c0": (2, "FC08 FB6400 FA6400 F732 F63200 FE 0101010101010101"),
}
"""By older firmware: number of bytes of a height, width or rate; commands that start pulses."""


class OldKit:
    """Emulated older firmware, which lacks the command F4. It waits forever for the rest of a
    command. A command FE for zero electrodes blocks its parser for good."""

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


class Meeting(ManualKit):
    """Driver that opens an unknown board. With ``named``, the user has named the firmware."""

    def __init__(self, patch, firmware="71adee2", named=False, board=None):
        super().__init__(
            patch,
            LIMITS,
            firmware,
            late_us=0,
            named=named,
            board=board,
            opened=False,
            dummy_ohm=66e3,
        )

    def open(self):
        """Open the board; return its capabilities."""
        return self.driver.open(self.line, LIMITS)

    def leave(self, text):
        self.clock.time_ns += 5_000_000
        self.board.feed(bytes.fromhex(text), self.clock.time_ns)
        self.clock.time_ns += 100_000_000
        self.board.advance(self.clock.time_ns)


@pytest.fixture
def meet(monkeypatch):
    return lambda *arguments, **more: Meeting(monkeypatch, *arguments, **more)


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("half", HALVES)
def test_a_board_that_pulses_is_at_zero_and_its_parser_found(meet, firmware, half):
    """The driver relies on a host timeout only if the user has named the firmware."""
    meeting = meet(firmware, named=bool(half))
    meeting.leave(PULSING + SENSE + half)
    pulsed = meeting.books.slots
    assert pulsed > 0
    can = meeting.open()
    assert (firmware in can.firmware) == bool(half)
    assert (can.time_to_zero_ms is None) == (firmware != "newest" or not half)
    slots = meeting.books.slots
    meeting.board.advance(meeting.clock.time_ns + 3_000_000_000)
    assert meeting.books.slots == slots
    assert meeting.books.state == "shorted"
    # Allow three scans of 8 slots: scans run until the stop; zeros may complete a command.
    assert slots - pulsed <= 24
    # 2.57 mA are 0x0101 counts, the height in the earlier program's incomplete command.
    assert meeting.books.max_current_ma <= 2.57


def test_half_a_command_ends_by_itself_where_zeros_are_lost(meet):
    meeting = meet()
    meeting.leave("FCF0 FE 0101")
    write = meeting.port.write
    meeting.port.write = lambda data: len(data) if data == ZEROS else write(data)
    meeting.open()
    assert meeting.books.state == "shorted"


@pytest.mark.parametrize("half", sample(HALVES))
@pytest.mark.parametrize("firmware", OLD)
def test_an_older_firmware_is_put_at_zero_and_refused(meet, firmware, half):
    size, pulsing = OLD[firmware]
    meeting = meet(board=OldKit(DeliveryLog(8), size))
    meeting.leave(pulsing + SENSE + half)
    assert meeting.board.books.slots > 0
    with raises(BoardError, names="firmware", value="71adee2"):
        meeting.open()
    assert meeting.board.pulses() == 0
    assert meeting.board.set[0xFC] == 0


@settings(max_examples=100 if WHOLE else 25, deadline=None)
@given(
    firmware=st.sampled_from([*FIRMWARES, *OLD]),
    noise=st.binary(max_size=12),
    half=HALF,
    losses=st.lists(st.integers(0, 700), max_size=1),
)
def test_no_probe_ever_makes_a_board_pulse(firmware, noise, half, losses):
    """A board at zero stays at zero, even if a byte of a probe is lost, or noise precedes it."""
    with pytest.MonkeyPatch.context() as patch:
        old = OldKit(DeliveryLog(8), OLD[firmware][0]) if firmware in OLD else None
        meeting = Meeting(patch, "71adee2" if old else firmware, board=old)
        # Send all settings of pulses except the height.
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
    meeting = meet(named=True, board=board)
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
        make_board(f"etactilekit:x?{option}", LIMITS)


@pytest.mark.parametrize(
    ("electrodes", "wiring", "outputs"), [(32, None, 32), (4, (5, 3, 0, 8), 9)]
)
def test_a_smaller_kit_than_the_profile_is_refused(meet, electrodes, wiring, outputs):
    """The largest output in ``wiring`` decides how many outputs the kit must have."""
    meeting = meet(named=True)
    limits = SafetyLimits(electrodes, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
    output = Output(kind="one-against-all", wiring=wiring)
    with raises(BoardError, value=outputs, allowed=8):
        ETactileKitDriver("told", limits, output).open(meeting.line, limits)


FOUR = SafetyLimits(4, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)


def pattern_of(sequence, wiring=None):
    output = Output(kind="one-against-all", wiring=wiring)
    return ETactileKitDriver("told", FOUR, output).encode(sequence)[1]


def anodic(level_ua, sites=(1,), width=100, cathodic=False, period_us=20_000):
    return one_each(
        FOUR, level_ua, width, 1.0, 0, cathodic=cathodic, sites=list(sites), discharge_us=50,
        period_us=period_us,
    )  # fmt: skip


def heights(*counts):
    return b"".join(count.to_bytes(2, "little") for count in counts)


def test_wiring_puts_each_electrode_on_its_output():
    pattern = pattern_of(anodic(1000), (5, 3, 0, 1))
    assert pattern == heights(0, 0, 0, 100, 0, 0)


@given(levels=st.lists(st.integers(0, 5000), min_size=4, max_size=4))
def test_no_byte_of_a_pattern_looks_like_a_command(levels):
    for site, level in enumerate(levels):
        data = pattern_of(anodic(level, sites=(site,)))
        assert max(data) < 0xF4
        counts = np.frombuffer(data, "<u2")
        assert counts.max() <= 500
        assert level - 9.99 * counts.max() <= max(6, 12 * 9.99 + 6)


@pytest.mark.parametrize(("wrong", "attributes"), [
    ("polarity", {}),
    ("width", {}),
    ("short", {"value": 6, "allowed": 7}),
    ("discharge", {"value": 244}),
])  # fmt: skip
def test_what_it_has_only_one_of_or_not_at_all_is_refused(wrong, attributes):
    sequence = anodic(1000, sites=(1, 2))
    if wrong == "polarity":
        sequence.current_ua[1] *= -1
    elif wrong == "width":
        sequence.width_us[1] = 90
    elif wrong == "short":
        sequence = replace(sequence, width_us=np.full(2, 6, np.uint16))
    else:
        sequence = replace(sequence, discharge_us=np.full(2, 244, np.uint16))
    with raises(BoardError, **attributes):
        pattern_of(sequence)


@given(data=st.data())
def test_a_lost_byte_never_brings_more_current_than_was_asked_for(data):
    """One of the messages lacks one byte, at any position. All other messages are complete."""
    pattern = pattern_of(anodic(2200, (1, 3)))
    messages = [
        Settings(100, 50, 50, True).commands(10) + PING,
        LOAD + pattern + PING,
        READINGS + GO + PING,
        READINGS + QUIET + PING,
    ]
    which = data.draw(st.integers(0, 3))
    where = data.draw(st.integers(0, len(messages[which]) - 1))
    books = DeliveryLog(4)
    board = ETactileKitFirmware(books)
    board.feed(b"\xfc\x04", 1_000_000)
    now_ns = 2_000_000
    for number, message in enumerate(messages):
        lost = number == which
        if lost:
            message = message[:where] + message[where + 1 :]
        answer = board.feed(message, now_ns)
        for _ in range(50):
            now_ns += 1_000_000
            answer += board.advance(now_ns)
        if answer[-1:] != b"\x04":
            # The answer to PING is missing, so reset the parser as the driver does.
            board.feed(bytes(514), now_ns)
            board.feed(QUIET + bytes(4) + PING, now_ns)
            break
    board.advance(now_ns + 500_000_000)
    assert books.max_current_ma <= 2.2
    assert books.max_charge_uc <= 0.221


OUTPUTS = 4
HEIGHTS = bytes([200, 0] * OUTPUTS)
COMMANDS = Settings(100, 50, 100, anodic=True).commands(10) + LOAD + HEIGHTS + GO
RUNNING = bytes([0xFC, OUTPUTS]) + COMMANDS
ZERO = zero_anywhere(OUTPUTS)
PLACES = [*sample(range(len(ZERO) - 40), 16), *range(len(ZERO) - 40, len(ZERO))]
"""Positions in ``ZERO``: a sample of its many leading zero bytes, and its last 40 bytes."""


@pytest.fixture(params=sample(FIRMWARES))
def drives_after(request):
    """Return a function that feeds parts to a kit, and returns whether it still pulses."""

    def drives_after(*parts):
        books = DeliveryLog(OUTPUTS)
        board = ETactileKitFirmware(books, firmware=request.param)
        now_ns = 0
        for part in parts:
            board.feed(part, now_ns)
            # Let a scan end: the parser of one firmware waits until a scan is over.
            now_ns += 10**8
            board.advance(now_ns)
        before = books.slots
        # Wait for more than a period at 10 Hz, but less than the host timeout.
        board.advance(now_ns + 25 * 10**7)
        return books.slots > before

    return drives_after


def test_zero_ends_every_half_command_and_survives_losses(drives_after):
    assert drives_after(RUNNING)
    for cut in range(len(COMMANDS) + 1):
        assert not drives_after(RUNNING, COMMANDS[:cut] + ZERO)
    for first in PLACES:
        assert not drives_after(RUNNING, ZERO[:first] + ZERO[first + 1 :])
        for run in (2, 1, 3):
            assert not drives_after(RUNNING, ZERO[:first] + ZERO[first + run :] + ZERO)


T = 20_000_000


@pytest.fixture
def lock():
    return ScanLock(T)


def test_what_is_not_renewed_or_contradicted_is_forgotten(lock):
    lock.learn(Span(0, 1_000_000))
    lock.learn(Span(8_000_000, 9_000_000))
    assert lock.last is None
    lock.learn(Span(0, 1_000_000))
    lock.check(400 * T)
    assert lock.last is not None
    lock.check(700 * T)
    assert lock.last is None


@given(
    phase=st.integers(0, T - 1),
    drift=st.floats(-200e-6, 200e-6),
    seed=st.integers(0, 1000),
    step=st.integers(1, 30),
)
def test_it_is_never_wrong(phase, drift, seed, step):
    rng = random.Random(seed)
    true = T * (1 + drift)
    lock = ScanLock(T)
    for number in range(0, 40 * step, step):
        start = phase + number * true
        bracket = Span(int(start - rng.uniform(0, 1e6)), int(start + rng.uniform(1, 1e6)))
        lock.learn(bracket)
        assert lock.last is not None
        for other in range(-3, 4):
            at = start + other * true
            scan = lock.scan(lock.first_after(int(at - T // 2)))
            assert scan.early <= at + 1
            assert at - 1 <= scan.late
        begin, end = sorted(rng.uniform(start, start + 5 * T) for _ in range(2))
        happened = sum(begin < phase + k * true < end for k in range(number - 1, number + 8))
        spread = rng.uniform(0, 1e6)
        least, most = lock.starts(
            Span(int(begin - spread), int(begin + spread)), Span(int(end), int(end + spread))
        )
        assert least <= happened <= most
