"""Zero commands of an eTactileKit work wherever its parser stands."""

import pytest

from smarttouch.boards.emulator.delivery_log import DeliveryLog
from smarttouch.boards.emulator.etactilekit import ETactileKitFirmware
from smarttouch.boards.etactilekit_pulses import Settings
from smarttouch.boards.etactilekit_wire import HeightCodec, ModeCodec

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
