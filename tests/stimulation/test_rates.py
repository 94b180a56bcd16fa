"""Each class keeps its own grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.stimulation.pulse_rates import SLOWEST, PulseRates, rate_share

FULL = {Afferent.RA: 1.0, Afferent.SAI: 1.0}


def pulses(rates, seconds, shares=FULL):
    """Follow the rates as a loop would; return when each class pulsed, s."""
    time_ns, found = 0, {Afferent.RA: [], Afferent.SAI: []}
    while time_ns < seconds * 1e9:
        due, wait_us = rates.due(time_ns, shares)
        for afferent in due:
            found[afferent].append(time_ns / 1e9)
        time_ns += 1000 * wait_us
    return found


@given(st.floats(2, 90), st.floats(2, 90))
def test_each_class_pulses_at_its_own_rate(ra_hz, sai_hz):
    found = pulses(PulseRates({Afferent.RA: ra_hz, Afferent.SAI: sai_hz}, 5000), 4.0)
    for afferent, rate_hz in ((Afferent.RA, ra_hz), (Afferent.SAI, sai_hz)):
        assert len(found[afferent]) == pytest.approx(4.0 * rate_hz, abs=2)
        # At most as early as pulses are merged, and never late.
        assert np.abs(np.diff(found[afferent]) - 1 / rate_hz).max(initial=0) <= 0.005 + 1e-6


@given(st.floats(2, 200), st.floats(2, 200))
def test_no_sequence_is_shorter_than_the_shortest(ra_hz, sai_hz):
    rates, time_ns = PulseRates({Afferent.RA: ra_hz, Afferent.SAI: sai_hz}, 5000), 0
    for _ in range(100):
        _, wait_us = rates.due(time_ns, FULL)
        assert wait_us >= 5000
        time_ns += 1000 * wait_us


def test_a_little_lateness_does_not_make_the_next_sequence_too_short():
    rates = PulseRates({Afferent.RA: 200.0}, 5000)
    rates.due(0, FULL)
    assert rates.due(5_900_000, FULL) == ((Afferent.RA,), 5000)


def test_a_late_class_begins_a_new_grid():
    rates = PulseRates({Afferent.RA: 10.0}, 5000)
    assert rates.due(0, FULL) == ((Afferent.RA,), 100_000)
    assert rates.due(470_000_000, FULL) == ((Afferent.RA,), 100_000)


def test_a_rate_that_fell_lets_a_class_wait():
    rates = PulseRates({Afferent.SAI: 50.0}, 5000)
    assert rates.due(0, FULL) == ((Afferent.SAI,), 20_000)
    assert rates.due(20_000_000, {Afferent.SAI: 0.2}) == ((), 80_000)
    rates.restart()
    assert rates.due(21_000_000, {Afferent.SAI: 0.2})[0] == (Afferent.SAI,)


def test_softness():
    assert [rate_share(pressure, 1.0) for pressure in (0, 0.5, 1)] == [1, 1, 1]
    assert [rate_share(pressure, 0.0) for pressure in (0, 0.5, 1)] == [SLOWEST, 0.5, 1]
    assert rate_share(0.5, 0.5) == 0.75
