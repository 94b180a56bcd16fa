"""What means zero on an eTactileKit, wherever its parser stands."""

import pytest

from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.etactilekit import ETactileKitFirmware
from smarttouch.boards.etactilekit_wire import ON, Settings, pattern, zero_anywhere

OUTPUTS = 4
RUNNING = (
    bytes([0xFC, OUTPUTS])
    + Settings(100, 50, 100, anodic=True).commands()
    + pattern(bytes([200, 0] * OUTPUTS))
    + ON
)


def drives_after(data):
    """Return whether an eTactileKit pulses a second after these bytes."""
    books = Books(OUTPUTS)
    firmware = ETactileKitFirmware(books)
    firmware.feed(data, 0)
    # A scan that has begun may end as it was.
    firmware.advance(10**8)
    before = books.slots
    firmware.advance(10**9)
    return books.slots > before


def test_zero_ends_every_half_command():
    assert drives_after(RUNNING)
    zero = zero_anywhere(OUTPUTS)
    another = RUNNING[2:].replace(b"\xc8\0", b"\x64\0")
    for cut in range(len(another) + 1):
        assert not drives_after(RUNNING + another[:cut] + zero)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_zero_written_twice_survives_a_loss_anywhere(run):
    zero = zero_anywhere(OUTPUTS)
    for first in range(len(zero)):
        assert not drives_after(RUNNING + zero[:first] + zero[first + run :] + zero)


def test_one_byte_lost_of_a_single_zero_is_survived():
    zero = zero_anywhere(OUTPUTS)
    for lost in range(len(zero)):
        assert not drives_after(RUNNING + zero[:lost] + zero[lost + 1 :])
