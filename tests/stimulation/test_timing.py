"""A board is never asked for a scan faster than it can be done."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import ScheduleError
from smarttouch.profile import load_profile
from smarttouch.stimulation.pulse_rates import ScanTiming

from ..raising import raises

KAJIMOTO = ScanTiming(50, 150, slot_extra_us=8, scan_us=700, in_index_order=True, load=1 / 1.1)
ETACTILEKIT = ScanTiming(slot_extra_us=10, every_electrode=True, whole_hz=True, load=0.9)


def test_without_a_board_only_the_slots_count():
    assert ScanTiming().shortest_period_us(5, 64, 200, 100) == 1500
    assert ScanTiming().shortest_period_us(0, 64, 200, 100) == 0


def test_the_61_kit():
    """Interval of 0.7 ms and 0.208 ms for each active electrode, plus 10 %."""
    assert KAJIMOTO.shortest_period_us(61, 61, 50, 150) == math.ceil(1.1 * (700 + 208 * 61))
    assert KAJIMOTO.shortest_period_us(0, 61, 50, 150) == pytest.approx(770, abs=1)


@pytest.mark.parametrize("slots", [0, 1, 32])
def test_an_idle_electrode_takes_time_too(slots):
    """32 times 210 µs is 6.72 ms, in 0.9 of a period: 133 Hz."""
    assert ETACTILEKIT.shortest_period_us(slots, 32, 100, 100) == math.ceil(1e6 / 133)


@given(st.floats(5000, 999_999))
def test_whole_hertz_are_rounded_down(period_us):
    possible = ETACTILEKIT.possible_period_us(period_us)
    rate_hz = round(1e6 / possible)
    assert possible >= period_us
    assert possible == math.ceil(1e6 / rate_hz)
    assert math.ceil(1e6 / (rate_hz + 1)) < math.ceil(period_us), "the next hertz is too fast"
    assert ETACTILEKIT.possible_period_us(possible) == possible


@given(st.integers(0, 255), st.floats(10, 200), st.floats(20, 255))
def test_a_scan_fits_its_share_of_the_period(slots, width_us, discharge_us):
    period_us = ETACTILEKIT.shortest_period_us(slots, 255, width_us, discharge_us)
    assert 255 * (width_us + discharge_us + 10) <= 0.9 * period_us
    period_us = KAJIMOTO.shortest_period_us(slots, 255, width_us, discharge_us)
    assert (slots * (width_us + discharge_us + 8) + 700) * 1.1 <= period_us * (1 + 1e-9)


def test_less_than_one_hertz_is_no_rate():
    with raises(ScheduleError, value=1.476):
        ETACTILEKIT.shortest_period_us(0, 255, 200, 5000)


@pytest.mark.parametrize(("timing", "key", "value", "allowed"), [
    (ScanTiming(width_us=100), "pulse.width_us", 50, 100),
    (ScanTiming(50, 20), "pulse.discharge_us", 150, 20),
])  # fmt: skip
def test_other_pulses_than_the_board_s(timing, key, value, allowed):
    profile = load_profile("kajimoto-61")
    KAJIMOTO.check(profile)
    remedy = f"{key} = {allowed}"
    with raises(ScheduleError, names=key, value=value, allowed=allowed) as error:
        timing.check(profile)
    assert remedy in str(error.value)
