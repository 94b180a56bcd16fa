"""Rates and intensity follow force, classes keep their pulse times, and periods suit the board."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.profile import ForceLaw, load_profile
from smarttouch.stimulation.scan_sequence import ScanTiming
from smarttouch.stimulation.scheduler import (
    SLOWEST,
    PulseRates,
    force_gate,
    rate_share,
)

from ..support.checks import raises

LINEAR = ForceLaw(law="linear", contact_n=0.2, full_n=1.0)
LOGARITHMIC = ForceLaw(law="logarithmic", contact_n=0.2, full_n=1.0)


@pytest.mark.parametrize(("law", "half_n"), [(LINEAR, 0.6), (LOGARITHMIC, math.sqrt(0.2))])
def test_intensity_at_a_force(law, half_n):
    assert [force_gate(force_n, law) for force_n in (0.0, 0.2, -3.0, math.nan)] == [0.0] * 4
    assert force_gate(half_n, law) == pytest.approx(0.5)
    assert [force_gate(force_n, law) for force_n in (1.0, 50.0, math.inf)] == [1.0] * 3


KAJIMOTO = ScanTiming(50, 150, slot_extra_us=8, scan_us=700, in_index_order=True, load=1 / 1.1)
ETACTILEKIT = ScanTiming(slot_extra_us=10, every_electrode=True, whole_hz=True, load=0.9)


@given(st.floats(5000, 999_999))
def test_whole_hertz_are_rounded_down(period_us):
    possible = ETACTILEKIT.shortest_period_us(period_us)
    rate_hz = round(1e6 / possible)
    assert possible >= period_us
    assert possible == math.ceil(1e6 / rate_hz)
    assert math.ceil(1e6 / (rate_hz + 1)) < math.ceil(period_us), "a rate 1 Hz higher also fits"
    assert ETACTILEKIT.shortest_period_us(possible) == possible


@given(st.integers(0, 255), st.floats(10, 200), st.floats(20, 255))
def test_a_scan_fits_its_share_of_the_period(slots, width_us, discharge_us):
    period_us = ETACTILEKIT.shortest_period_us(0, slots, 255, width_us, discharge_us)
    assert 255 * (width_us + discharge_us + 10) <= 0.9 * period_us
    period_us = KAJIMOTO.shortest_period_us(0, slots, 255, width_us, discharge_us)
    assert (slots * (width_us + discharge_us + 8) + 700) * 1.1 <= period_us * (1 + 1e-9)


def test_less_than_one_hertz_is_no_rate():
    with raises(ScheduleError, value=1.476):
        ETACTILEKIT.shortest_period_us(0, 0, 255, 200, 5000)


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


def pulses(rates, seconds):
    """Run the timetable in simulated time; return the pulse times of each class, s."""
    time_ns, found = 0, {Afferent.RA: [], Afferent.SAI: []}
    while time_ns < seconds * 1e9:
        due, wait_us = rates.due(time_ns)
        for afferent in due:
            found[afferent].append(time_ns / 1e9)
        time_ns += 1000 * wait_us
    return found


@given(st.floats(2, 90), st.floats(2, 90))
def test_each_class_pulses_at_its_own_rate(ra_hz, sai_hz):
    found = pulses(PulseRates({Afferent.RA: ra_hz, Afferent.SAI: sai_hz}, 5000), 4.0)
    for afferent, rate_hz in ((Afferent.RA, ra_hz), (Afferent.SAI, sai_hz)):
        assert len(found[afferent]) == pytest.approx(4.0 * rate_hz, abs=2)
        # Merging with a pulse of the other class moves a pulse by at most 5 ms.
        assert np.abs(np.diff(found[afferent]) - 1 / rate_hz).max(initial=0) <= 0.005 + 1e-6


@given(st.floats(2, 200), st.floats(2, 200))
def test_no_sequence_is_shorter_than_the_shortest(ra_hz, sai_hz):
    rates, time_ns = PulseRates({Afferent.RA: ra_hz, Afferent.SAI: sai_hz}, 5000), 0
    for _ in range(100):
        _, wait_us = rates.due(time_ns)
        assert wait_us >= 5000
        time_ns += 1000 * wait_us


BOTH = Afferent.RA, Afferent.SAI


def test_a_little_lateness_does_not_make_the_next_sequence_too_short():
    rates = PulseRates(dict.fromkeys(BOTH, 200.0), 5000)
    rates.due(0)
    assert rates.due(5_900_000) == (BOTH, 5000)


@pytest.mark.parametrize("time_ns", [130_000_000, 470_000_000])
def test_a_late_class_begins_a_new_grid(time_ns):
    rates = PulseRates(dict.fromkeys(BOTH, 10.0), 5000)
    assert rates.due(0) == (BOTH, 100_000)
    assert rates.due(time_ns) == (BOTH, 100_000)


def test_a_rate_that_fell_lets_a_class_wait():
    rates = PulseRates(dict.fromkeys(BOTH, 50.0), 5000, softness=0.0)
    assert rates.due(0) == (BOTH, 20_000)
    assert rates.due(20_000_000, 0.2) == ((Afferent.RA,), 20_000)
    rates.restart()
    assert rates.due(21_000_000, 0.2)[0] == BOTH


def test_softness():
    assert [rate_share(pressure, 1.0) for pressure in (0, 0.5, 1)] == [1, 1, 1]
    assert [rate_share(pressure, 0.0) for pressure in (0, 0.5, 1)] == [SLOWEST, 0.5, 1]
    assert rate_share(0.5, 0.5) == 0.75
