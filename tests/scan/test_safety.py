"""Every limit raises, and nothing that keeps them is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.errors import SafetyError
from smarttouch.scan.safety import SafetyGate, SafetyLimits
from smarttouch.scan.sequence import ScanSequence

LIMITS = SafetyLimits(
    electrodes=4,
    current_ma=3.0,
    pulse_us=200,
    charge_uc=0.5,
    rate_hz=100,
    duty=0.6,
    ramp_s=0.5,
    full_ma=2.4,
    total_ma=4.0,
    electrode_ma=(3.0, 3.0, 3.0, 0.7),
)
SECOND = 10**9


def sequence(currents, *, width=200, discharge=100, period=20_000, intensity=1.0, time_ns=SECOND):
    currents = np.asarray(currents, np.int16).reshape(-1, 4)
    slots = len(currents)
    return ScanSequence(
        current_ua=currents,
        width_us=np.full(slots, width, np.uint16),
        discharge_us=np.full(slots, discharge, np.uint16),
        site=np.zeros(slots, np.uint16),
        period_us=period,
        intensity=intensity,
        time_ns=time_ns,
    )


def warmed():
    """A gate that has seen a silent start a second before."""
    gate = SafetyGate(LIMITS)
    gate.prove(sequence([], intensity=0.0, time_ns=0))
    return gate


GOOD = [[-2400, 1200, 600, 600]]


def test_a_good_sequence_passes():
    warmed().prove(sequence(GOOD))


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (sequence([[-2400, 1200, 600, 599]]), "slot 0 is out of balance by -1"),
        (sequence([[0, 0, 0, 0], [1, 0, 0, 0]]), "slot 1 is out of balance"),
        (sequence([[-3001, 3001, 0, 0]], width=100), "electrode 0: 3.001 mA is above"),
        (sequence([[-2600, 2600, 0, 0]], width=200), "0.520 µC is above"),
        (sequence([[-2500, 2500, 0, 0]], width=190), "more than intensity"),
        (sequence([[-2400, 2400, 0, 0]], intensity=0.5), "more than intensity"),
        (
            sequence([GOOD[0], [-2100, -2100, 2100, 2100]]),
            "slot 1: 4.200 mA flow in all, above .* 4",
        ),
        (sequence([[-1200, 300, 199, 701]]), "electrode 3: 0.701 mA is above its own limit of 0.7"),
        (sequence(GOOD, width=201), "widths run from 201 to 201"),
        (sequence(GOOD, width=0), "widths run from 0"),
        (sequence(GOOD, period=9_999), "faster than the limit of 100 Hz"),
        (sequence(GOOD, period=0), "faster than the limit"),
        (sequence(GOOD * 67), "67 slots take 20100 µs, longer than"),
        (sequence(GOOD * 61, discharge=20, period=20_000), "current flows 61%"),
        (sequence(GOOD, intensity=1.1), "must lie between 0 and 1"),
        (sequence(GOOD, intensity=float("nan")), "more than intensity|between 0 and 1"),
        (sequence(GOOD, time_ns=0), "does not follow"),
        (sequence(GOOD, time_ns=SECOND // 10), "rises from 0.000 to 1.000"),
        (
            dataclasses.replace(sequence(GOOD), current_ua=np.array(GOOD, np.int32)),
            "must be int16",
        ),
        (
            dataclasses.replace(sequence(GOOD), width_us=np.array([200.0])),
            "width_us is float64",
        ),
        (dataclasses.replace(sequence(GOOD), current_ua=np.zeros((1, 5), np.int16)), r"\(1, 5\)"),
    ],
)
def test_each_limit_raises(bad, words):
    with pytest.raises(SafetyError, match=words):
        warmed().prove(bad)


def test_the_most_negative_current_is_not_mistaken_for_a_small_one():
    with pytest.raises(SafetyError, match=r"32\.768 mA"):
        warmed().prove(sequence([[-32768, 32767, 1, 0]], width=1))


def test_nothing_may_come_on_at_the_start():
    with pytest.raises(SafetyError, match=r"rises from 0.000"):
        SafetyGate(LIMITS).prove(sequence([[-24, 24, 0, 0]], intensity=0.01, time_ns=0))


def test_a_refused_sequence_does_not_count_as_the_one_before():
    gate = warmed()
    with pytest.raises(SafetyError):
        gate.prove(sequence([[-2400, 2400, 0, 1]], time_ns=SECOND))
    with pytest.raises(SafetyError, match=r"rises from 0.000"):
        gate.prove(sequence(GOOD, time_ns=SECOND // 10))


@pytest.mark.parametrize(
    "change",
    [
        {"current_ma": 5.1},
        {"pulse_us": 201},
        {"charge_uc": 0.51},
        {"ramp_s": 0.1},
        {"full_ma": 4},
        {"total_ma": float("nan")},
        {"total_ma": 0},
        {"electrode_ma": (1.0,)},
        {"electrode_ma": (1.0, float("nan"), 1.0, 1.0)},
    ],
)
def test_limits_stay_under_the_ceilings(change):
    with pytest.raises(SafetyError, match=next(iter(change))):
        dataclasses.replace(LIMITS, **change)


@given(
    st.lists(st.lists(st.integers(-32768, 32767), min_size=4, max_size=4), min_size=1, max_size=4),
    st.integers(0, 400),
    st.integers(1, 30_000),
)
def test_what_passes_keeps_every_limit(currents, width, period):
    tried = sequence(currents, width=width, period=period)
    try:
        warmed().prove(tried)
    except SafetyError:
        return
    flow = tried.current_ua.astype(int)
    assert not flow.sum(axis=1).any()
    assert np.abs(flow).max() <= 3000
    assert np.abs(flow).sum(axis=1).max() <= 2 * 4000
    assert np.abs(flow[:, 3]).max() <= 700
    assert np.abs(flow).max() * width <= 500_000
    assert 0 < width <= 200
    assert tried.slots * (width + 100) <= period
