"""To the byte: what goes to an eTactileKit of each generation, and what always means zero."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError
from smarttouch.boards.kits.current_scale import scale_of
from smarttouch.boards.kits.etactilekit_wire import HeightCodec, ModeCodec, Settings, settings_of
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.etactilekit_firmware import ETactileKitFirmware
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..raising import raises

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


def test_modes_to_the_byte():
    codec = ModeCodec(4)
    # 220 counts at 9.99 µA, as in the board's own example.
    payload = codec.payload(anodic(2200), WIRING, SCALE, LIMITS)
    assert payload == heights(0, 220, 0, 0)
    assert codec.load(payload) == b"\xfb\x02\xfe" + payload
    assert codec.go(payload) == b"\xfb\x00"
    assert codec.quiet == b"\xfb\x02\xfb\x02"
    assert codec.nothing == bytes(8)
    assert (codec.question, codec.answer_bytes, codec.readings_bytes) == (b"\xf4", 1, 8)
    assert codec.is_answer(b"\x04")
    assert not any(codec.is_answer(each) for each in (b"", b"\x05", b"\x04\x04"))


def test_heights_to_the_byte():
    codec = HeightCodec(4)
    payload = codec.payload(anodic(2200, (1, 3)), WIRING, SCALE, LIMITS)
    assert payload == b"\0\x01\0\x01\xdc\0"
    quiet = (b"\xfb\0\0" + END) * 2
    assert codec.quiet == quiet
    assert codec.load(payload) == quiet + b"\xfe\0\x01\0\x01"
    assert codec.go(payload) == b"\xfb\xdc\0" + END
    assert codec.nothing == bytes(6)
    assert (codec.lead, codec.question, codec.answer_bytes) == (END, b"\xff", 8)
    assert codec.is_answer(bytes(8))
    assert not codec.is_answer(bytes(7))


@pytest.mark.parametrize("codec", [ModeCodec(4), HeightCodec(4)])
def test_settings_come_twice_and_between_at_a_rate_that_fits_old_and_new(codec):
    commands = codec.settings(Settings(100, 50, 100, True), 40)
    once = (
        codec.quiet + END + b"\xf9\0" + END + b"\xf8\0" + END + b"\xf6\x28\0" + END
        + b"\xfd\x01" + END + b"\xfa\x64\0" + END + b"\xf7\x32" + END
    )  # fmt: skip
    assert commands == once * 2 + (b"\xf6\x64\0" + END) * 2


@pytest.mark.parametrize("codec", [ModeCodec(6), HeightCodec(6)])
def test_wiring_puts_each_electrode_on_its_output(codec):
    payload = codec.payload(anodic(1000), np.array([5, 3, 0, 1]), SCALE, LIMITS)
    assert (
        payload
        == {ModeCodec: heights(0, 0, 0, 100, 0, 0), HeightCodec: b"\0\0\0\x01\0\0\x64\0"}[
            type(codec)
        ]
    )


def test_several_heights_are_several_patterns_of_the_older_firmware():
    codec = HeightCodec(4)
    sequence = anodic(2000, (0, 1, 2))
    sequence.current_ua[1] //= 2
    payload = codec.payload(sequence, WIRING, SCALE, LIMITS)
    low, high = codec.parts(payload)
    assert low == b"\0\x01\0\0" + heights(100)
    assert high == b"\x01\0\x01\0" + heights(200)
    # What rounding makes of one current is not two.
    sequence = anodic(2000, (1, 2))
    sequence.current_ua[1] += np.array([-2, -2, 6, -2], np.int16)
    assert codec.payload(sequence, WIRING, SCALE, LIMITS)[-2:] == heights(200)
    assert ModeCodec(4).parts(bytes(8)) == [bytes(8)]


@given(levels=st.lists(st.integers(0, 5000), min_size=4, max_size=4))
def test_no_byte_of_a_pattern_looks_like_a_command(levels):
    for site, level in enumerate(levels):
        for codec in (ModeCodec(4), HeightCodec(4)):
            data = codec.payload(anodic(level, sites=(site,)), WIRING, SCALE, LIMITS)
            assert max(data) < 0xF4
            counts = np.frombuffer(data[-2:] if isinstance(codec, HeightCodec) else data, "<u2")
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
    ("polarity", {"about": "current_ua"}),
    ("width", {"about": "width_us"}),
    ("short", {"about": "width_us", "value": 6, "allowed": 7}),
    ("discharge", {"about": "discharge_us", "value": 244}),
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


@pytest.mark.parametrize(
    ("codec", "firmware"), [(ModeCodec(4), "71adee2"), (HeightCodec(4), "936c6c0")]
)
@given(data=st.data())
def test_a_lost_byte_never_brings_more_current_than_was_asked_for(codec, firmware, data):
    """Of any message, behind any whole one, and with the messages after it."""
    payload = codec.payload(anodic(2200, (1, 3)), WIRING, SCALE, LIMITS)
    messages = [
        codec.lead + codec.settings(Settings(100, 50, 50, True), 10) + codec.question,
        codec.lead + codec.load(payload) + codec.question,
        codec.lead + b"\xff" + codec.go(payload) + codec.question,
        codec.lead + b"\xff" + codec.quiet + codec.question,
    ]
    which = data.draw(st.integers(0, 3))
    where = data.draw(st.integers(0, len(messages[which]) - 1))
    books = DeliveryLog(4)
    board = ETactileKitFirmware(books, firmware=firmware)
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
        if not codec.is_answer(answer[-codec.answer_bytes :] if answer else b""):
            # What the driver does then.
            board.feed(bytes(514), now_ns)
            board.feed(codec.quiet + bytes(4) + codec.question, now_ns)
            break
    board.advance(now_ns + 500_000_000)
    assert books.max_current_ma <= 2.2
    assert books.max_charge_uc <= 0.221


OUTPUTS = 4
SETTINGS = Settings(100, 50, 100, anodic=True)


class Kit:
    """One generation, pulsing, and what means zero for it."""

    def __init__(self, firmware, codec):
        self.firmware, self.codec = firmware, codec(OUTPUTS)
        if codec is HeightCodec:
            payload = bytes([1] * OUTPUTS + [200, 0])
        else:
            payload = bytes([200, 0] * OUTPUTS)
        self.zero = self.codec.zero_anywhere
        self.commands = (
            self.codec.settings(SETTINGS, 10) + self.codec.load(payload) + self.codec.go(payload)
        )
        self.running = bytes([0xFC, OUTPUTS]) + self.commands

    def drives_after(self, *parts):
        """Return whether it pulses on after bytes that come a scan apart."""
        books = DeliveryLog(OUTPUTS)
        board = ETactileKitFirmware(books, firmware=self.firmware)
        now_ns = 0
        for part in parts:
            board.feed(part, now_ns)
            # Some parsers stand still while a scan goes on.
            now_ns += 10**8
            board.advance(now_ns)
        before = books.slots
        # Scans come at 10 or 100 Hz, and the newest firmware bears so long without a host.
        board.advance(now_ns + 25 * 10**7)
        return books.slots > before


@pytest.fixture(params=[("71adee2", ModeCodec), ("newest", ModeCodec), ("936c6c0", HeightCodec)])
def kit(request):
    return Kit(*request.param)


def test_zero_ends_every_half_command(kit):
    assert kit.drives_after(kit.running)
    for cut in range(len(kit.commands) + 1):
        assert not kit.drives_after(kit.running, kit.commands[:cut] + kit.zero)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_zero_written_twice_survives_a_loss_anywhere(kit, run):
    zero = kit.zero
    for first in range(len(zero)):
        assert not kit.drives_after(kit.running, zero[:first] + zero[first + run :] + zero)


def test_one_byte_lost_of_a_single_zero_is_survived(kit):
    zero = kit.zero
    for lost in range(len(zero)):
        assert not kit.drives_after(kit.running, zero[:lost] + zero[lost + 1 :])
