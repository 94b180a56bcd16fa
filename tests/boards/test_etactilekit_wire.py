"""To the byte: what goes to an eTactileKit, and what always means zero."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError
from smarttouch.boards.kits.current_scale import scale_of
from smarttouch.boards.kits.etactilekit_wire import (
    GO,
    LOAD,
    PING,
    QUIET,
    READINGS,
    Settings,
    payload,
    settings_commands,
    settings_of,
    zero_anywhere,
)
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.etactilekit_firmware import FIRMWARES, ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..raising import raises
from ..whole import sample

LIMITS = SafetyLimits(4, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
WIRING = np.arange(4)
END = bytes(3)

SCALE = scale_of("etactilekit", None)


def anodic(level_ua, sites=(1,), width=100, cathodic=False, period_us=20_000):
    return one_each(
        LIMITS, level_ua, width, 1.0, 0, cathodic=cathodic, sites=list(sites), discharge_us=50,
        period_us=period_us,
    )  # fmt: skip


def heights(*counts):
    return b"".join(count.to_bytes(2, "little") for count in counts)


def test_wiring_puts_each_electrode_on_its_output():
    pattern = payload(anodic(1000), np.array([5, 3, 0, 1]), SCALE, LIMITS)
    assert pattern == heights(0, 0, 0, 100, 0, 0)


@given(levels=st.lists(st.integers(0, 5000), min_size=4, max_size=4))
def test_no_byte_of_a_pattern_looks_like_a_command(levels):
    for site, level in enumerate(levels):
        data = payload(anodic(level, sites=(site,)), WIRING, SCALE, LIMITS)
        assert max(data) < 0xF4
        counts = np.frombuffer(data, "<u2")
        assert counts.max() <= 500
        assert level - 9.99 * counts.max() <= max(6, 12 * 9.99 + 6)


def test_settings_of_a_sequence():
    assert settings_of(anodic(1000)) == Settings(100, 50, 50, True)
    assert settings_of(anodic(1000, cathodic=True, period_us=16_667)) == Settings(
        100, 50, 60, False
    )
    assert Settings(100, 50, 60, True).period_ns == 16_666_000
    assert Settings(100, 50, 60, True).scan_us(32, 10) == 5120


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
        settings_of(sequence)


@given(data=st.data())
def test_a_lost_byte_never_brings_more_current_than_was_asked_for(data):
    """Of any message, behind any whole one, and with the messages after it."""
    pattern = payload(anodic(2200, (1, 3)), WIRING, SCALE, LIMITS)
    messages = [
        settings_commands(Settings(100, 50, 50, True), 10) + PING,
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
            # What the driver does then.
            board.feed(bytes(514), now_ns)
            board.feed(QUIET + bytes(4) + PING, now_ns)
            break
    board.advance(now_ns + 500_000_000)
    assert books.max_current_ma <= 2.2
    assert books.max_charge_uc <= 0.221


OUTPUTS = 4
HEIGHTS = bytes([200, 0] * OUTPUTS)
COMMANDS = settings_commands(Settings(100, 50, 100, anodic=True), 10) + LOAD + HEIGHTS + GO
RUNNING = bytes([0xFC, OUTPUTS]) + COMMANDS
ZERO = zero_anywhere(OUTPUTS)
PLACES = [*sample(range(len(ZERO) - 40), 16), *range(len(ZERO) - 40, len(ZERO))]
"""In what means zero: few of its many zeros, and all that comes after them."""


@pytest.fixture(params=FIRMWARES)
def drives_after(request):
    """Return a function that returns whether a kit pulses on after bytes that come a scan apart."""

    def drives_after(*parts):
        books = DeliveryLog(OUTPUTS)
        board = ETactileKitFirmware(books, firmware=request.param)
        now_ns = 0
        for part in parts:
            board.feed(part, now_ns)
            # One parser stands still while a scan goes on.
            now_ns += 10**8
            board.advance(now_ns)
        before = books.slots
        # Scans come at 10 or 100 Hz, and the newest firmware bears so long without a host.
        board.advance(now_ns + 25 * 10**7)
        return books.slots > before

    return drives_after


def test_zero_ends_every_half_command(drives_after):
    assert drives_after(RUNNING)
    for cut in range(len(COMMANDS) + 1):
        assert not drives_after(RUNNING, COMMANDS[:cut] + ZERO)


@pytest.mark.parametrize("run", sample([2, 1, 3], 3))
def test_zero_written_twice_survives_a_loss_anywhere(drives_after, run):
    for first in PLACES:
        assert not drives_after(RUNNING, ZERO[:first] + ZERO[first + run :] + ZERO)


def test_one_byte_lost_of_a_single_zero_is_survived(drives_after):
    for lost in PLACES:
        assert not drives_after(RUNNING, ZERO[:lost] + ZERO[lost + 1 :])
