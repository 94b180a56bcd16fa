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


def strong(ppb, time_ns, **other):
    """A pulse of the least charge that counts as much as it claims: a quarter of its share."""
    current_ua = math.ceil(Fraction(ppb * FULL.full_ua, 4 * WHOLE))
    pulses = pair(current_ua) + pair(-current_ua)
    return sequence(pulses, width=200, intensity=intensity_of(ppb), time_ns=time_ns, **other)


def warmed(oracle=None):
    """An oracle in which half a second of weak current has opened every level."""
    oracle = oracle or Oracle(FULL)
    time_ns = 1
    assert oracle.judge(sequence([], intensity=0, time_ns=time_ns - 1), time_ns - 1) == []
    for step in range(1, STEPS + 1):
        assert oracle.judge(strong(step * WHOLE // STEPS, time_ns, period=100_000), time_ns) == []
        time_ns += OPENED_NS // STEPS
    return oracle


OPENED_PC = sum(2 * 200 * math.ceil(step * 750 / STEPS) for step in range(1, STEPS + 1))
"""Charge through an electrode that has been in by then."""


def started():
    """An oracle that has seen a silent start, and a weak pass of a twentieth of a second."""
    oracle = Oracle(FULL)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    assert oracle.judge(strong(2 * 10**8, 1, period=50_000), 1) == []
    return oracle


def test_claimed_time_rises():
    oracle = warmed()
    assert oracle.judge(sequence([], intensity=0, time_ns=1), START) == ["time"]
    assert oracle.judge(sequence([], intensity=1, time_ns=NS), START) == []


def test_the_first_is_silent():
    # A picocoulomb is less than a thousand parts per billion of a full pulse.
    strongest = Oracle(replace(FULL, full_ua=Fraction(10_000)))
    first = {"width": 1, "time_ns": 0}
    stronger = sequence(pair(1), intensity=intensity_of(1_001), **first)
    assert strongest.judge(stronger, 10 * NS) == ["rise"]
    assert strongest.judge(sequence(pair(1), intensity=intensity_of(1_000), **first), 10 * NS) == []
    assert Oracle(FULL).judge(sequence(pair(1), intensity=0.1, **first), 10 * NS) == ["rise"]
    # Intensity that is claimed without current is nothing.
    assert Oracle(FULL).judge(sequence([]), 10 * NS) == []


def test_a_level_is_opened_by_the_time_of_current():
    """A twentieth of a second is a tenth of the ramp, and what a sequence may be late a fifth."""
    most = 100_000_000 + 200_000_000 + 1_000
    assert started().judge(strong(most, NS), NS) == []
    assert started().judge(strong(most + 1, NS), NS) == ["rise"]
    at_half = most - 50_000_000
    assert started().judge(strong(at_half, NS), NS // 40 + 1) == []
    assert started().judge(strong(at_half + 1, NS), NS // 40 + 1) == ["rise"]
    assert started().judge(strong(at_half + 1, NS // 40 + 1), NS) == []


def test_what_is_replaced_before_it_is_written_opens_nothing_and_lowers_nothing():
    oracle = Oracle(FULL)
    assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
    assert oracle.judge(strong(2 * 10**8, 1, period=500_000), 1, written=False) == []
    assert oracle.judge(strong(3 * 10**8, NS), NS) == ["rise"]
    oracle.wrote(oracle.newest, NS)
    assert oracle.judge(strong(3 * 10**8, NS), NS + NS // 20) == []
    assert oracle.judge(strong(10**8, 2 * NS), 2 * NS, written=False) == []
    assert oracle.judge(strong(4 * 10**8, 3 * NS), 3 * NS) == []


def test_and_no_further_than_current_was_strong():
    """Half a second is the whole ramp, but a fifth and its fourfold is all that has flowed."""
    for ppb, opened in ((2 * 10**8, 200_000_000), (10**9, 133_333_336)):
        oracle = Oracle(FULL)
        assert oracle.judge(sequence([], intensity=0, time_ns=0), 0) == []
        one = strong(2 * 10**8, 1, period=500_000)
        if ppb == 10**9:
            # 100 µA for 200 µs: a thirtieth.
            one = sequence(pair(100), width=200, intensity=1.0, time_ns=1, period=500_000)
        assert oracle.judge(one, 1) == []
        most = opened + 200_001_000
        assert oracle.judge(strong(most + 1, NS), NS) == ["strength"]
        assert oracle.judge(strong(most, NS), NS) == []


def test_a_level_stays_for_fifteen_seconds():
    over_ns = 50_000_000 + 1 + 15 * NS
    assert started().judge(strong(300_001_000, over_ns), over_ns) == []
    assert started().judge(strong(200_001_000, over_ns + 1), over_ns + 1) == []
    late = strong(200_001_001, over_ns + 1)
    assert started().judge(late, over_ns + 1) == ["rise"]


def test_a_clock_that_falls_gives_no_time():
    oracle = started()
    for step in range(2, 20):
        back = strong(2 * 10**8, step * NS)
        assert oracle.judge(back, (step % 2) * 1000) == []
    assert oracle.judge(strong(3 * 10**8, 20 * NS), 0) == ["rise"]


def test_what_is_refused_changes_nothing():
    oracle = started()
    late = sequence([[1, 0, 0, 0]], time_ns=10 * NS)
    assert oracle.judge(late, 10 * NS) == ["balance"]
    assert oracle.judge(strong(3 * 10**8, NS), 1) == ["rise"]
    assert oracle.judge(strong(3 * 10**8, NS), NS) == []


def driven(oracle, count, made, step_ns, start_ns=START):
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
    assert now_ns == START + NS
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
    assert oracle.judge(replace(made, current_ua=-made.current_ua, time_ns=START), START) == []
    now_ns = driven(oracle, 62, made, 10_000_000, start_ns=START + 20_000_000)
    one = replace(made, time_ns=now_ns)
    assert oracle.judge(one, now_ns) == ["net in a second"]
    assert oracle.judge(one, now_ns + NS // 2) == []


def test_a_phase_takes_back_what_was_carried():
    oracle, back = warmed(), {"recharge_ua": np.array([-60, 60, 0, 0], np.int16)}
    made = sequence(pair(600), time_ns=START, recharge_us=1000, **back)
    # 60 nC.
    assert oracle.judge(made, START) == []
    oracle = warmed()
    more = sequence(pair(600), time_ns=START, recharge_us=1002, **back)
    assert oracle.judge(more, START) == ["takes back"]
    first = sequence(pair(0), intensity=0, time_ns=0, recharge_us=1, **back)
    assert Oracle(FULL).judge(first, 0) == ["takes back"]


def test_sequences_of_a_second():
    oracle, made = warmed(), sequence([], period=10_000)
    # 100 Hz, and 100 ms ahead.
    now_ns = driven(oracle, 111, made, 100_000, start_ns=START + 30_000_000)
    assert oracle.judge(replace(made, time_ns=now_ns), now_ns) == ["sequences in a second"]


def test_repetitions_are_judged_before_they_begin():
    made = sequence(twin(600, 30), period=20_000, time_ns=START)
    assert warmed().judge(made, START, times=50) == []
    # The 51st begins before the last slot of the first has left the second.
    assert warmed().judge(made, START, times=51) == ["strong in a second"]
    oracle = warmed()
    assert oracle.judge(sequence(twin(600, 14), time_ns=START), START, times=3) == []
    strong = [oracle.in_the_second_before(START + ns)[0][0] for ns in (0, 19_999_999, 20_000_000)]
    assert [int(each) for each in strong] == [14, 14, 28]


def test_a_newer_sequence_ends_repetitions():
    oracle, made = warmed(), sequence(pair(600, 15), period=20_000)
    assert oracle.judge(made, START, times=3) == []
    silent = sequence([], time_ns=START + NS)
    assert oracle.judge(silent, START + 19_999_999) == []
    assert oracle.in_the_second_before(START + 90_000_000)[0][0] == 15


def test_time_of_a_session():
    made = sequence(pair(1), period=1_000_000)
    # Those that opened the level are half a second of 600.
    assert warmed().judge(made, START, times=599) == []
    assert warmed().judge(made, START, times=601) == ["session time"]
    assert warmed().judge(sequence([], period=1_000_000), START, times=601) == []
    oracle = warmed()
    assert oracle.judge(made, START, times=599) == []
    # Cut short after ten: the others are given back, also where the board restarts.
    again = replace(made, time_ns=START + NS)
    assert oracle.judge(again, START + 10 * NS - 1, times=590) == ["session time"]
    assert oracle.judge(again, START + 10 * NS - 1, times=589) == []
    oracle.restart(START + 11 * NS - 2)
    # Eleven seconds, twice half a second of weak current, and what they leave.
    warmed(oracle)
    assert oracle.judge(again, START, times=589) == ["session time"]
    assert oracle.judge(again, START, times=588) == []


def test_charge_of_a_session():
    small = warmed(Oracle(replace(FULL, session_pc=OPENED_PC + 1_000_000)))
    made = sequence(pair(1000), width=100)
    assert small.judge(made, START, times=11) == ["session charge"]
    assert small.judge(made, START, times=10) == []
    assert small.judge(replace(made, time_ns=START + NS), START + NS) == ["session charge"]
    assert small.judge(replace(made, time_ns=START + NS), START + 1, times=9) == []


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


HERE = Path(__file__).parent
ORACLE = ("bounds", "rules", "quick", "oracle", "deliveries")
"""The modules that judge; the others ask them, and the gate."""
MAY = (
    "smarttouch.profile",
    "smarttouch.profile.electrodes",
    "smarttouch.emulator.firmware",
    "smarttouch.emulator.skin",
)
"""What they may know of the package: data, geometry, and what an emulator wrote down."""


def imports_of(path):
    """Return the absolute names of everything a module imports, relative ones from `tests`."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append("." * node.level + (node.module or ""))
    return names


@pytest.mark.parametrize("name", ORACLE)
def test_the_oracle_imports_nothing_of_the_gate(name):
    for imported in imports_of(HERE / f"{name}.py"):
        if imported.startswith("smarttouch"):
            assert imported in MAY
        elif imported.startswith("."):
            assert imported.lstrip(".") in ORACLE
            assert not imported.startswith("..")
        else:
            assert imported.split(".")[0] in {*sys.stdlib_module_names, "numpy"}
            assert imported != "importlib"
