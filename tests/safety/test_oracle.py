"""The rules from one sequence to the next by hand, and what the oracle reads of a profile."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np

from .bounds import NS, Bounds
from .by_hand import FULL, pair, sequence
from .displays import display
from .drafts import intensity_of
from .oracle import Oracle

WEAK = pair(1)


def warmed(oracle=None):
    """An oracle in which a second of the least current has opened every level."""
    oracle = oracle or Oracle(FULL)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    low = intensity_of(10**8)
    weak = sequence(WEAK, width=1, intensity=low, period=979_999, time_ns=1)
    assert oracle.judge(weak, 20_000_000) == []
    return oracle


def started():
    """An oracle that has seen a silent start, and a weak pass of a quarter of a second."""
    oracle = Oracle(FULL)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    weak = sequence(WEAK, intensity=intensity_of(10**8), period=250_000, time_ns=1)
    assert oracle.judge(weak, 1) == []
    return oracle


def weak(ppb, time_ns):
    return sequence(WEAK, intensity=intensity_of(ppb), time_ns=time_ns)


def test_claimed_time_rises():
    oracle = warmed()
    assert oracle.judge(weak(10**9, 2), NS) == ["claimed rise"]
    assert oracle.judge(sequence([], intensity=0, time_ns=1), NS) == ["time"]
    assert oracle.judge(sequence([], intensity=1, time_ns=2), NS) == []


def test_the_first_is_silent():
    assert Oracle(FULL).judge(weak(1_000, 0), 10 * NS) == []
    assert Oracle(FULL).judge(weak(1_001, 0), 10 * NS) == ["claimed rise"]
    # Intensity that is claimed without current is nothing.
    assert Oracle(FULL).judge(sequence([]), 10 * NS) == []


def test_a_level_is_opened_by_the_time_of_current():
    """A quarter of a second is half of the ramp, and what a sequence may be late a fifth."""
    most = 500_000_000 + 200_000_000 + 1_000
    assert started().judge(weak(most, NS), NS) == []
    assert started().judge(weak(most + 1, NS), NS) == ["claimed rise", "rise"]
    at_half = most - 500_000_000 + 250_000_000
    assert started().judge(weak(at_half, NS), NS // 8 + 1) == []
    assert started().judge(weak(at_half + 1, NS), NS // 8 + 1) == ["rise"]
    assert started().judge(weak(at_half + 1, NS // 8 + 1), NS) == ["claimed rise"]


def test_a_level_stays_for_fifteen_seconds():
    over_ns = 250_000_000 + 1 + 15 * NS
    assert started().judge(weak(700_001_000, over_ns), over_ns) == []
    assert started().judge(weak(200_001_000, over_ns + 1), over_ns + 1) == []
    late = weak(200_001_001, over_ns + 1)
    assert started().judge(late, over_ns + 1) == ["claimed rise", "rise"]


def test_a_clock_that_falls_gives_no_time():
    oracle = started()
    for step in range(2, 20):
        back = weak(2 * 10**8, step * NS)
        assert oracle.judge(back, (step % 2) * 1000) == []
    assert oracle.judge(weak(3 * 10**8, 20 * NS), 0) == ["rise"]


def test_what_is_refused_changes_nothing():
    oracle = warmed()
    late = sequence([[1, 0, 0, 0]], time_ns=10 * NS)
    assert oracle.judge(late, 10 * NS) == ["balance"]
    assert oracle.judge(weak(10**9, NS), NS // 10) == ["rise"]
    assert oracle.judge(weak(10**9, NS), NS) == []


def driven(oracle, count, made, step_ns, start_ns=NS):
    """Send so many sequences, one a step; return the clock of the next."""
    for index in range(count):
        clock_ns = start_ns + index * step_ns
        assert oracle.judge(replace(made, time_ns=clock_ns), clock_ns) == []
    return start_ns + count * step_ns


def twin(first, count):
    """Slots of both signs in turn, which leave nothing."""
    return pair(first, count // 2) + pair(-first, count // 2)


def test_strong_pulses_of_any_second():
    """A pass counts until its last slot has left the second: thirty of 150 µs."""
    oracle, made = warmed(), sequence(twin(600, 30))
    now_ns = driven(oracle, 50, made, 20_000_000)
    assert now_ns == 2 * NS
    one = sequence(pair(600), time_ns=now_ns)
    assert oracle.judge(one, now_ns + 30 * 150_000 - 1) == ["strong in a second"]
    assert oracle.judge(one, now_ns + 30 * 150_000) == []


def test_mean_current_of_any_second():
    oracle = warmed()
    made = sequence(twin(2000, 24), width=200)
    # 9.6 µC each: 52 of them fit, as fast as they can be sent.
    now_ns = driven(oracle, 52, made, 1_000_000)
    one = sequence(twin(2000, 4), width=200, time_ns=now_ns)
    assert oracle.judge(one, now_ns) == ["mean in a second"]


def test_net_current_of_any_second():
    """0.8 µC a pass: 62 of them are 49.6 µC, of the newest alone whatever was before."""
    oracle, made = warmed(), sequence(pair(2000, 2), width=200, period=10_000)
    assert oracle.judge(replace(made, current_ua=-made.current_ua, time_ns=NS), NS) == []
    now_ns = driven(oracle, 62, made, 10_000_000, start_ns=NS + 20_000_000)
    one = replace(made, time_ns=now_ns)
    assert oracle.judge(one, now_ns) == ["net in a second"]
    assert oracle.judge(one, now_ns + NS // 2) == []


def test_a_phase_takes_back_what_was_carried():
    oracle, back = warmed(), {"recharge_ua": np.array([-60, 60, 0, 0], np.int16)}
    made = sequence(pair(600), time_ns=NS, recharge_us=1000, **back)
    # 60 nC, and a pC of the weak pass is carried too.
    assert oracle.judge(made, NS) == []
    oracle = warmed()
    more = sequence(pair(600), time_ns=NS, recharge_us=1002, **back)
    assert oracle.judge(more, NS) == ["takes back"]
    first = sequence(pair(0), intensity=0, time_ns=0, recharge_us=1, **back)
    assert Oracle(FULL).judge(first, 0) == ["takes back"]


def test_sequences_of_a_second():
    oracle, made = warmed(), sequence([], period=10_000)
    # 100 Hz, and 100 ms ahead; the pass that opened the level has begun a second ago.
    now_ns = driven(oracle, 111, made, 100_000, start_ns=NS + 30_000_000)
    assert oracle.judge(replace(made, time_ns=now_ns), now_ns) == ["sequences in a second"]


def test_repetitions_are_judged_before_they_begin():
    made = sequence(twin(600, 30), period=20_000, time_ns=NS)
    assert warmed().judge(made, NS, times=50) == []
    # The 51st begins before the last slot of the first has left the second.
    assert warmed().judge(made, NS, times=51) == ["strong in a second"]
    oracle = warmed()
    assert oracle.judge(sequence(twin(600, 14), time_ns=NS), NS, times=3) == []
    strong = [oracle.in_the_second_before(NS + ns)[0][0] for ns in (0, 19_999_999, 20_000_000)]
    assert [int(each) for each in strong] == [14, 14, 28]


def test_a_newer_sequence_ends_repetitions():
    oracle, made = warmed(), sequence(pair(600, 15), period=20_000)
    assert oracle.judge(made, NS, times=3) == []
    silent = sequence([], time_ns=2 * NS)
    assert oracle.judge(silent, NS + 19_999_999) == []
    assert oracle.in_the_second_before(NS + 90_000_000)[0][0] == 15


def test_time_of_a_session():
    made = sequence(pair(1), period=1_000_000)
    # The pass that opened the level is one of 600 s.
    assert warmed().judge(made, NS, times=599) == []
    assert warmed().judge(made, NS, times=601) == ["session time"]
    assert warmed().judge(sequence([], period=1_000_000), NS, times=601) == []
    oracle = warmed()
    assert oracle.judge(made, NS, times=599) == []
    # Cut short after ten: the others are given back, also where the board restarts.
    again = replace(made, time_ns=2 * NS)
    assert oracle.judge(again, 11 * NS - 1, times=590) == ["session time"]
    assert oracle.judge(again, 11 * NS - 1, times=589) == []
    oracle.restart(12 * NS - 2)
    # Eleven seconds, twice a second of the least current, and what they leave.
    warmed(oracle)
    assert oracle.judge(again, NS, times=588) == ["session time"]
    assert oracle.judge(again, NS, times=587) == []


def test_charge_of_a_session():
    small = warmed(Oracle(replace(FULL, session_pc=1_000_001)))
    made = sequence(pair(1000), width=100)
    assert small.judge(made, NS, times=11) == ["session charge"]
    assert small.judge(made, NS, times=10) == []
    assert small.judge(replace(made, time_ns=2 * NS), 2 * NS) == ["session charge"]
    assert small.judge(replace(made, time_ns=2 * NS), NS + 1, times=9) == []


def test_a_measuring_scan_need_not_rise():
    measured = sequence(pair(2000))
    assert Oracle(FULL).judge(measured, 0, measuring=True) == []
    assert Oracle(FULL).judge(measured, 0) == ["claimed rise", "rise"]
    assert Oracle(FULL).judge(sequence(pair(3001)), 0, measuring=True) == ["current"]


def test_bounds_of_profiles():
    """By hand, from the definitions."""
    mouse = Bounds.of(display("electric-mouse"))
    assert (mouse.electrodes, mouse.charge_pc, mouse.total_ua) == (64, 500_000, 10_000)
    assert mouse.electrode_ua == (5000,) * 64
    assert (mouse.pulse_us, mouse.ramp_ns, mouse.late_rise) == (200, NS // 2, 200_000_000)
    assert (mouse.rounding_ua, mouse.session_us) == (33, 3600 * 10**6)
    # 1.2 in single precision is a little more than 1.2.
    assert mouse.strong_ua == (601,) * 64
    assert mouse.recharge_ua == (120,) * 64
    assert 2400 < mouse.full_ua < Fraction(24_001, 10)
    # A disc of .5 mm has .196 mm²: 100 µC/cm² are .196 µC.
    assert Bounds.of(display("small discs")).charge_pc == math.floor(math.pi / 16 * 10**6)
    # A ring of 1.0 and .85 mm has .2179 mm².
    ring = math.floor(math.pi / 4 * (1 - 0.85**2) * 10**6)
    assert Bounds.of(display("rings")).charge_pc == ring
    assert Bounds.of(display("points")).charge_pc == 500_000
    finger = Bounds.of(display("one finger"))
    assert finger.electrode_ua == (1900, 1100, 900, 1750, 1200, 2000, 777)
    assert (finger.total_ua, finger.strong_ua[2]) == (3333, 167)
    slow = Bounds.of(display("slow"))
    assert (slow.pulse_us, slow.rate_hz) == (150, Fraction(603, 10))
