"""The rules from one sequence to the next by hand, and what the oracle reads of a profile."""

import math
from dataclasses import replace
from fractions import Fraction

from .bounds import NS, Bounds
from .by_hand import FULL, pair, sequence
from .displays import display
from .drafts import intensity_of
from .oracle import Oracle


def warmed():
    """An oracle that has seen a silent start, a second before."""
    oracle = Oracle(FULL)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    return oracle


def test_claimed_time_rises():
    oracle = warmed()
    assert oracle.judge(sequence([], time_ns=5), NS, 1) == ["claimed rise"]
    assert oracle.judge(sequence([], intensity=0, time_ns=0), NS) == ["time"]
    assert oracle.judge(sequence([], intensity=0, time_ns=1), NS) == []


def test_the_first_is_silent():
    assert Oracle(FULL).judge(sequence([], intensity=1e-6), 10 * NS) == []
    assert Oracle(FULL).judge(sequence([], intensity=1.01e-6), 10 * NS) == ["claimed rise"]


def test_intensity_rises_with_claimed_time():
    half = NS // 4
    assert (
        warmed().judge(sequence([], intensity=intensity_of(500_001_000), time_ns=half), 9 * NS)
        == []
    )
    faster = sequence([], intensity=intensity_of(500_001_001), time_ns=half)
    assert warmed().judge(faster, 9 * NS) == ["claimed rise"]


def test_intensity_rises_with_the_clock():
    """A fifth of the ramp is what a sequence may be late by."""
    assert warmed().judge(sequence([], intensity=intensity_of(700_001_000)), NS // 4) == []
    assert warmed().judge(sequence([], intensity=intensity_of(700_001_001)), NS // 4) == ["rise"]
    oracle = warmed()
    for step in range(1, 4):
        # Time of the clock that was not used is lost: up by .2 at once and no more.
        quiet = sequence([], intensity=intensity_of(10**8), time_ns=2 * step * NS)
        assert oracle.judge(quiet, step * NS) == []
        jump = sequence([], intensity=intensity_of(300_001_001), time_ns=2 * step * NS + NS)
        assert oracle.judge(jump, step * NS) == ["rise"]


def test_a_clock_that_falls_gives_no_time():
    oracle = warmed()
    assert oracle.judge(sequence([], intensity=intensity_of(2 * 10**8), time_ns=NS), 1000) == []
    for step in range(2, 20):
        back = sequence([], intensity=intensity_of(2 * 10**8), time_ns=step * NS)
        assert oracle.judge(back, (step % 2) * 1000) == []
    assert oracle.judge(sequence([], intensity=intensity_of(3 * 10**8), time_ns=20 * NS), 0) == [
        "rise"
    ]


def test_what_is_refused_changes_nothing():
    oracle = warmed()
    late = sequence([[1, 0, 0, 0]], time_ns=50 * NS)
    assert oracle.judge(late, 50 * NS) == ["balance"]
    assert oracle.judge(sequence([], time_ns=NS), NS // 10) == ["rise"]
    assert oracle.judge(sequence([], time_ns=NS), NS) == []


def driven(oracle, count, made, step_ns, start_ns=NS):
    """Send so many sequences, one a step; return the clock of the next."""
    for index in range(count):
        clock_ns = start_ns + index * step_ns
        assert oracle.judge(replace(made, time_ns=clock_ns), clock_ns) == []
    return start_ns + count * step_ns


def test_strong_pulses_of_any_second():
    """Sequences that replace each other before their time: fifty with thirty pulses each."""
    oracle, made = warmed(), sequence(pair(600, 30))
    now_ns = driven(oracle, 50, made, 10**6)
    one = sequence(pair(600), time_ns=now_ns)
    assert oracle.judge(one, now_ns) == ["strong in a second"]
    # The first was sent at one second: it is out of the window from two on.
    assert oracle.judge(replace(one, time_ns=2 * NS), 2 * NS - 1) == ["strong in a second"]
    assert oracle.judge(replace(made, time_ns=2 * NS), 2 * NS) == []
    assert oracle.judge(replace(one, time_ns=3 * NS), 2 * NS) == ["strong in a second"]


def test_mean_current_of_any_second():
    oracle, made = warmed(), sequence(pair(2000, 25), width=200)
    now_ns = driven(oracle, 50, made, 10**6)
    one = sequence(pair(1), width=1, time_ns=now_ns)
    assert oracle.judge(one, now_ns) == ["mean in a second"]
    assert oracle.judge(replace(one, time_ns=2 * NS), 2 * NS) == []


def test_repetitions_count_when_they_begin():
    oracle, made = warmed(), sequence(pair(600, 30), period=20_000)
    assert oracle.judge(made, NS, times=1000) == []
    # Of one period each: fifty begin in any second.
    assert oracle.judge(replace(made, time_ns=4 * NS), 4 * NS) == ["strong in a second"]
    assert oracle.judge(sequence(pair(599), time_ns=4 * NS), 4 * NS) == []
    oracle, made = warmed(), sequence(pair(600, 15), period=20_000)
    assert oracle.judge(made, NS, times=3) == []
    strong, _ = oracle.in_the_second_before(NS)
    assert strong.tolist() == [15, 15, 0, 0]
    assert oracle.in_the_second_before(NS + 20_000_000 - 1)[0][0] == 15
    assert oracle.in_the_second_before(NS + 20_000_000)[0][0] == 30
    assert oracle.in_the_second_before(NS + 60_000_000)[0][0] == 45
    assert oracle.in_the_second_before(2 * NS)[0][0] == 30


def test_a_newer_sequence_ends_repetitions():
    oracle, made = warmed(), sequence(pair(600, 15), period=20_000)
    assert oracle.judge(made, NS, times=3) == []
    silent = sequence([], time_ns=2 * NS)
    assert oracle.judge(silent, NS + 19_999_999) == []
    assert oracle.in_the_second_before(NS + 90_000_000)[0][0] == 15


def test_time_of_a_session():
    made = sequence(pair(1), period=1_000_000)
    assert warmed().judge(made, NS, times=600) == []
    assert warmed().judge(made, NS, times=601) == ["session time"]
    assert warmed().judge(sequence([], period=1_000_000), NS, times=601) == []
    oracle = warmed()
    assert oracle.judge(made, NS, times=600) == []
    # Cut short after ten: the others are given back, also where the board restarts.
    again = replace(made, time_ns=2 * NS)
    assert oracle.judge(again, 11 * NS - 1, times=591) == ["session time"]
    assert oracle.judge(again, 11 * NS - 1, times=590) == []
    oracle.restart(12 * NS - 2)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    assert oracle.judge(again, NS, times=590) == ["session time"]
    assert oracle.judge(again, NS, times=589) == []


def test_charge_of_a_session():
    small = Oracle(replace(FULL, session_pc=1_000_000))
    assert small.judge(sequence([], intensity=0, time_ns=0), 0) == []
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
