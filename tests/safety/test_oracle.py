"""The oracle's limits over time by hand, and what it may import."""

import ast
import math
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from .bounds import NS, WHOLE, Bounds
from .by_hand import FULL, pair, sequence
from .displays import display
from .drafts import intensity_of
from .oracle import Oracle

OPENED_NS, STEPS = 5 * NS // 10, 5
START = 3 * NS
"""When that is more than a second ago."""
SILENT = sequence([], intensity=0)
OPENED_PC = sum(2 * 200 * math.ceil(step * 750 / STEPS) for step in range(1, STEPS + 1))
"""Charge through an electrode of what opens a level."""


def ask(oracle, made, clock_ns, times=1, **other):
    """Judge a sequence that claims the time of the clock."""
    return oracle.judge(replace(made, time_ns=clock_ns), clock_ns, times, **other)


def strong(ppb, **other):
    """A pulse of the least charge that counts as much as it claims: a quarter of its share."""
    current_ua = math.ceil(Fraction(ppb * FULL.full_ua, 4 * WHOLE))
    pulses = pair(current_ua) + pair(-current_ua)
    return sequence(pulses, width=200, intensity=intensity_of(ppb), **other)


def begun(made=None):
    """An oracle that has seen a silent start, and then a sequence."""
    oracle = Oracle(FULL)
    assert ask(oracle, SILENT, 0) == []
    assert made is None or ask(oracle, made, 1) == []
    return oracle


def started():
    """An oracle that has seen a weak pass of a twentieth of a second."""
    return begun(strong(2 * 10**8, period=50_000))


def warmed(oracle=None):
    """An oracle in which half a second of weak current has opened every level."""
    oracle, time_ns = oracle or Oracle(FULL), 1
    assert ask(oracle, SILENT, 0) == []
    for step in range(1, STEPS + 1):
        assert ask(oracle, strong(step * WHOLE // STEPS, period=100_000), time_ns) == []
        time_ns += OPENED_NS // STEPS
    return oracle


def driven(oracle, count, made, step_ns, start_ns=START):
    """Send so many sequences, one a step; return the clock of the next."""
    for index in range(count):
        assert ask(oracle, made, start_ns + index * step_ns) == []
    return start_ns + count * step_ns


def twin(first, count):
    """Slots of both signs in turn, which leave nothing."""
    return pair(first, count // 2) + pair(-first, count // 2)


def test_claimed_time_rises():
    oracle = warmed()
    assert oracle.judge(sequence([], intensity=0, time_ns=1), START) == ["time"]
    assert oracle.judge(sequence([], intensity=1, time_ns=NS), START) == []


def test_the_first_is_silent():
    # A picocoulomb is less than a thousand parts per billion of a full pulse.
    strongest = Oracle(replace(FULL, full_ua=Fraction(10_000)))
    for ppb, broken in ((1_001, ["rise"]), (1_000, [])):
        first = sequence(pair(1), width=1, intensity=intensity_of(ppb))
        assert ask(strongest, first, 10 * NS) == broken
    # Intensity that is claimed without current is nothing.
    assert ask(Oracle(FULL), sequence([]), 10 * NS) == []


OVER_NS = 50_000_000 + 1 + 15 * NS
"""A level stays open for fifteen seconds."""


@pytest.mark.parametrize(("most_ppb", "clock_ns"), [
    # A twentieth of a second is a tenth of the ramp; what a sequence may be late is a fifth.
    (300_001_000, NS), (250_001_000, NS // 40 + 1), (300_001_000, OVER_NS),
    (200_001_000, OVER_NS + 1),
])  # fmt: skip
def test_a_level_is_opened_by_the_time_of_current(most_ppb, clock_ns):
    assert ask(started(), strong(most_ppb), clock_ns) == []
    assert ask(started(), strong(most_ppb + 1), clock_ns) == ["rise"]


@pytest.mark.parametrize(("made", "opened"), [
    (strong(2 * 10**8, period=500_000), 200_000_000),
    # 100 µA for 200 µs: a thirtieth.
    (sequence(pair(100), width=200, period=500_000), 133_333_336),
])  # fmt: skip
def test_and_no_further_than_current_was_strong(made, opened):
    """Half a second is the whole ramp, but a fifth and its fourfold is all that has flowed."""
    oracle, most = begun(made), opened + 200_001_000
    assert ask(oracle, strong(most + 1), NS) == ["rise"]
    assert ask(oracle, strong(most), NS) == []


def test_what_is_replaced_before_it_is_written_opens_nothing_and_lowers_nothing():
    oracle = begun()
    assert ask(oracle, strong(2 * 10**8, period=500_000), 1, written=False) == []
    assert ask(oracle, strong(3 * 10**8), NS) == ["rise"]
    oracle.wrote(oracle.newest, NS)
    assert ask(oracle, strong(3 * 10**8), NS + NS // 20) == []
    assert ask(oracle, strong(10**8), 2 * NS, written=False) == []
    assert ask(oracle, strong(4 * 10**8), 3 * NS) == []


def test_a_clock_that_falls_gives_no_time_and_what_is_refused_changes_nothing():
    oracle = started()
    assert oracle.judge(sequence([[1, 0, 0, 0]], time_ns=10 * NS), 10 * NS) == ["balance"]
    for step in range(2, 20):
        back = strong(2 * 10**8, time_ns=step * NS)
        assert oracle.judge(back, (step % 2) * 1000) == []
    assert oracle.judge(strong(3 * 10**8, time_ns=20 * NS), 0) == ["rise"]


@pytest.mark.parametrize(("made", "count", "step_ns", "one", "wait_ns", "rule"), [
    # A pass counts until its last slot has left the second: thirty of 150 µs.
    (sequence(twin(600, 30)), 50, 20_000_000, sequence(pair(600)), 4_500_000, "strong"),
    # 9.6 µC each: 52 of them fit, as fast as they can be sent.
    (sequence(twin(2000, 24), width=200), 52, 1_000_000, sequence(twin(2000, 4), width=200), NS,
     "mean"),
    # .8 µC a pass: 62 of them are 49.6 µC.
    (sequence(pair(2000, 2), width=200, period=10_000), 62, 10_000_000,
     sequence(pair(2000, 2), width=200, period=10_000), NS // 2, "net"),
    # 100 Hz, and 100 ms ahead.
    (sequence([], period=10_000), 111, 100_000, sequence([], period=10_000), NS, "sequences"),
])  # fmt: skip
def test_limits_of_any_second(made, count, step_ns, one, wait_ns, rule):
    oracle = warmed()
    now_ns = driven(oracle, count, made, step_ns)
    assert ask(oracle, one, now_ns) == [f"{rule} in a second"]
    assert ask(oracle, one, now_ns + wait_ns) == []


def test_a_phase_takes_back_what_was_carried():
    back = {"recharge_ua": np.array([-60, 60, 0, 0], np.int16)}
    # 60 nC.
    assert ask(warmed(), sequence(pair(600), recharge_us=1000, **back), START) == []
    assert ask(warmed(), sequence(pair(600), recharge_us=1002, **back), START) == ["takes back"]


def test_repetitions_are_judged_before_they_begin_and_ended_by_what_is_newer():
    made = sequence(twin(600, 30))
    assert ask(warmed(), made, START, 50) == []
    # The 51st begins before the last slot of the first has left the second.
    assert ask(warmed(), made, START, 51) == ["strong in a second"]
    oracle = warmed()
    assert ask(oracle, sequence(twin(600, 14)), START, 3) == []
    strong = [oracle.in_the_second_before(START + ns)[0][0] for ns in (0, 19_999_999, 20_000_000)]
    assert [int(each) for each in strong] == [14, 14, 28]
    assert ask(oracle, SILENT, START + 39_999_999) == []
    assert oracle.in_the_second_before(START + 90_000_000)[0][0] == 28


def test_time_of_a_session():
    made = sequence(pair(1), period=1_000_000)
    # Those that opened the level are half a second of 600.
    assert ask(warmed(), made, START, 601) == ["session time"]
    assert ask(warmed(), sequence([], period=1_000_000), START, 601) == []
    oracle = warmed()
    assert ask(oracle, made, START, 599) == []
    # Cut short after ten: the others are given back, also where the board restarts.
    again = START + 10 * NS - 1
    assert ask(oracle, made, again, 590) == ["session time"]
    assert ask(oracle, made, again, 589) == []
    oracle.restart(START + 11 * NS - 2)
    # Eleven seconds, twice half a second of weak current, and what they leave.
    warmed(oracle)
    assert ask(oracle, made, START, 589) == ["session time"]
    assert ask(oracle, made, START, 588) == []


def test_charge_of_a_session():
    small = warmed(Oracle(replace(FULL, session_pc=OPENED_PC + 1_000_000)))
    made = sequence(pair(1000), width=100)
    assert ask(small, made, START, 11) == ["session charge"]
    assert ask(small, made, START, 10) == []
    assert ask(small, made, START + NS) == ["session charge"]


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
    # A disc of .5 mm has .196 mm²: 100 µC/cm² are .196 µC. A ring of 1.0 and .85 mm has .2179 mm².
    assert Bounds.of(display("small discs")).charge_pc == math.floor(math.pi / 16 * 10**6)
    ring = math.floor(math.pi / 4 * (1 - 0.85**2) * 10**6)
    assert Bounds.of(display("rings")).charge_pc == ring
    finger = Bounds.of(display("one finger"))
    assert finger.electrode_ua == (1900, 1100, 900, 1750, 1200, 2000, 777)
    assert (finger.total_ua, finger.strong_ua[2]) == (3333, 167)
    slow = Bounds.of(display("slow"))
    assert (slow.pulse_us, slow.rate_hz) == (150, Fraction(603, 10))


ORACLE = ("bounds", "quick", "oracle", "delivery_judge")
"""The modules that judge; the others ask them, and the gate."""
MAY = (
    "smarttouch.profile", "smarttouch.profile.electrodes", "smarttouch.emulator.firmware",
    "smarttouch.emulator.skin",
)  # fmt: skip
"""What they may know of the package: data, geometry, and what an emulator wrote down."""


@pytest.mark.parametrize("name", ORACLE)
def test_the_oracle_imports_nothing_of_the_gate(name):
    allowed = {*MAY, *(f".{each}" for each in ORACLE), *sys.stdlib_module_names, "numpy"}
    allowed -= {"importlib"}
    source = (Path(__file__).parent / f"{name}.py").read_text("utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            assert {each.name for each in node.names} <= allowed
        elif isinstance(node, ast.ImportFrom):
            assert "." * node.level + (node.module or "") in allowed
