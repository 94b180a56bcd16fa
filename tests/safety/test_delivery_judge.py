"""`judge_pulses` checks each delivered pulse, and sums over each second."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.kajimoto61_firmware import Kajimoto61Firmware

from .attacked_profiles import display
from .bounds import Bounds
from .delivery_judge import Pulses, judge_pulses
from .short_sequences import FULL

MS = 1000


@pytest.fixture
def judges_books():
    """Keep the watch from judging delivery logs: no gate has proved the pulses of these tests."""
    return False


def pulses(rows, *, width=100, every_us=10 * MS, first_us=10**6, **other):
    """Return a pulse for each row of currents, µA, at equal intervals."""
    current = np.array(rows, np.float64).reshape(-1, 4)
    time_us = first_us + every_us * np.arange(len(current))
    return Pulses(current, current * width, time_us=time_us, **other)


ALIKE = replace(FULL, electrode_ua=(3000,) * 4)
INSIDE_AND_OUTSIDE = [
    ("current", pulses([3000, -3000, 0, 0]), pulses([3001, -3001, 0, 0])),
    # Skin divides the current of one source, so one of two cathodes may exceed 3000 µA.
    ("current", pulses([3400, 100, -2000, -1500]), pulses([3500, 0, -2000, -1500])),
    ("total", pulses([1750, 1750, -1750, -1750]), pulses([1760, 1760, -1760, -1760])),
    ("charge", pulses([2000, -2000, 0, 0], width=200), pulses([2001, -2001, 0, 0], width=200)),
    ("width", pulses([90, -90, 0, 0], width=200), pulses([90, -90, 0, 0], width=202)),
    ("balance", pulses([90, -89, 0, 0]), pulses([90, -87, 0, 0])),
    ("strong in a second", pulses([[900, -900, 0, 0]] * 1709, every_us=500, width=9), pulses(
        [[900, -900, 0, 0]] * 1711, every_us=500, width=9)),
    ("mean in a second", pulses([[2000, -2000, 0, 0]] * 1499, every_us=500, width=190), pulses(
        [[2000, -2000, 0, 0]] * 1501, every_us=500, width=190)),
]  # fmt: skip
"""Rules, each with pulses that just keep it and pulses that just break it."""


@pytest.mark.parametrize(("rule", "inside", "outside"), INSIDE_AND_OUTSIDE)
def test_pulses(rule, inside, outside):
    assert judge_pulses(inside, ALIKE) == []
    assert judge_pulses(outside, ALIKE) == [rule]


def test_books_of_a_kit(tmp_path):
    """Up to 128 steps of current keep the limits of the profile; 129 steps do not."""
    books = DeliveryLog(61, tmp_path)
    board = Kajimoto61Firmware(books)
    bounds = Bounds.of(display("kajimoto-61"))
    board.feed(bytes([0xFF]) + bytes(61), 0)
    for index, steps in enumerate((100, 128, 129)):
        board.feed(bytes([0xFF]) + bytes(30) + bytes([steps]) + bytes(30), (1 + index) * 10**9)
        board.advance((1 + index) * 10**9 + 10**8)
        books.write()
        found = judge_pulses(Pulses.of_books(tmp_path), bounds)
        assert found == ([] if steps < 129 else ["current", "total"])
