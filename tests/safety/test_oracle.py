"""The oracle's limits over time, with values computed by hand, and the modules it may import."""

import ast
import math
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from .attacked_profiles import display
from .bounds import NS, WHOLE, Bounds
from .drafts import intensity_of
from .oracle import Oracle
from .short_sequences import FULL, pair, sequence

OPENED_NS, STEPS = 5 * NS // 10, 5
START = 3 * NS
"""Clock time at which the sequences of `warmed` are more than a second old."""
SILENT = sequence([], intensity=0)
OPENED_PC = sum(2 * 200 * math.ceil(step * 750 / STEPS) for step in range(1, STEPS + 1))
"""Charge that the sequences of `warmed` pass through one electrode, pC."""


def ask(oracle, made, clock_ns, times=1, **other):
    """Let the oracle judge a sequence whose time is set to that of the clock."""
    return oracle.judge(replace(made, time_ns=clock_ns), clock_ns, times, **other)


def strong(ppb, **other):
    """Return the weakest sequence whose strength equals its intensity, with zero net charge."""
    current_ua = math.ceil(Fraction(ppb * FULL.full_ua, 4 * WHOLE))
    pulses = pair(current_ua) + pair(-current_ua)
    return sequence(pulses, width=200, intensity=intensity_of(ppb), **other)


def begun(made=None):
    """Return an oracle that has accepted a silent sequence, and then ``made`` if given."""
    oracle = Oracle(FULL)
    assert ask(oracle, SILENT, 0) == []
    assert made is None or ask(oracle, made, 1) == []
    return oracle


def started():
    """Return an oracle that has accepted a silent sequence and then weak current for 50 ms."""
    return begun(strong(2 * 10**8, period=50_000))


def warmed(oracle=None):
    """Raise the ramp of an oracle to full with half a second of weak current; return the oracle."""
    oracle, time_ns = oracle or Oracle(FULL), 1
    assert ask(oracle, SILENT, 0) == []
    for step in range(1, STEPS + 1):
        assert ask(oracle, strong(step * WHOLE // STEPS, period=100_000), time_ns) == []
        time_ns += OPENED_NS // STEPS
    return oracle


def driven(oracle, count, made, step_ns, start_ns=START):
    """Send ``count`` sequences, one every ``step_ns``; return the time for the next one."""
    for index in range(count):
        assert ask(oracle, made, start_ns + index * step_ns) == []
    return start_ns + count * step_ns


def twin(first, count):
    """Return slots without net charge: the second half reverses the current of the first."""
    return pair(first, count // 2) + pair(-first, count // 2)


def test_claimed_time_rises():
    oracle = warmed()
    assert oracle.judge(sequence([], intensity=0, time_ns=1), START) == ["time"]
    assert oracle.judge(sequence([], intensity=1, time_ns=NS), START) == []


def test_the_first_is_silent():
    # 1 pC is 500 ppb of a full pulse. The strength is the intensity, within 500 to 2000 ppb.
    strongest = Oracle(replace(FULL, full_ua=Fraction(10_000)))
    for ppb, broken in ((1_001, ["ramp"]), (1_000, [])):
        first = sequence(pair(1), width=1, intensity=intensity_of(ppb))
        assert ask(strongest, first, 10 * NS) == broken
    # A sequence without current has no strength, so its intensity does not matter.
    assert ask(Oracle(FULL), sequence([]), 10 * NS) == []


OVER_NS = 50_000_000 + 1 + 15 * NS
"""Last time at which the level of `started` is kept: 15 s after the end of its current."""


@pytest.mark.parametrize(("most_ppb", "clock_ns"), [
    # Current for 50 ms raises the level by 0.1; the allowance for late sequences adds 0.2.
    (300_001_000, NS), (250_001_000, NS // 40 + 1), (300_001_000, OVER_NS),
    (200_001_000, OVER_NS + 1),
])  # fmt: skip
def test_a_level_is_opened_by_the_time_of_current(most_ppb, clock_ns):
    assert ask(started(), strong(most_ppb), clock_ns) == []
    assert ask(started(), strong(most_ppb + 1), clock_ns) == ["ramp"]


@pytest.mark.parametrize(("made", "opened"), [
    (strong(2 * 10**8, period=500_000), 200_000_000),
    # 100 µA for 200 µs are 1/30 of a full pulse. The strength is at most four times as much.
    (sequence(pair(100), width=200, period=500_000), 133_333_336),
])  # fmt: skip
def test_and_no_further_than_current_was_strong(made, opened):
    """Half a second could raise the level to full, but the strength of the current limits it."""
    oracle, most = begun(made), opened + 200_001_000
    assert ask(oracle, strong(most + 1), NS) == ["ramp"]
    assert ask(oracle, strong(most), NS) == []


def test_what_is_replaced_before_it_is_written_opens_nothing_and_lowers_nothing():
    oracle = begun()
    assert ask(oracle, strong(2 * 10**8, period=500_000), 1, written=False) == []
    assert ask(oracle, strong(3 * 10**8), NS) == ["ramp"]
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
    assert oracle.judge(strong(3 * 10**8, time_ns=20 * NS), 0) == ["ramp"]


@pytest.mark.parametrize(("made", "count", "step_ns", "one", "wait_ns", "rule"), [
    # A pass counts until one second after its end. Its 30 slots take 4.5 ms.
    (sequence(twin(600, 30)), 50, 20_000_000, sequence(pair(600)), 4_500_000, "strong"),
    # A pass carries 9.6 µC, so 52 passes stay below the limit of 500 µC.
    (sequence(twin(2000, 24), width=200), 52, 1_000_000, sequence(twin(2000, 4), width=200), NS,
     "mean"),
    # A pass has a net charge of 0.8 µC, so 62 passes stay below the limit of 50 µC.
    (sequence(pair(2000, 2), width=200, period=10_000), 62, 10_000_000,
     sequence(pair(2000, 2), width=200, period=10_000), NS // 2, "net"),
    # In 1.1 s (1 s plus the allowed delay of 0.1 s), 110 passes begin at 100 Hz. 111 are allowed.
    (sequence([], period=10_000), 111, 100_000, sequence([], period=10_000), NS, "sequences"),
])  # fmt: skip
def test_limits_of_any_second(made, count, step_ns, one, wait_ns, rule):
    oracle = warmed()
    now_ns = driven(oracle, count, made, step_ns)
    assert ask(oracle, one, now_ns) == [f"{rule} in a second"]
    assert ask(oracle, one, now_ns + wait_ns) == []


def test_a_phase_takes_back_what_was_carried():
    back = {"recharge_ua": np.array([-60, 60, 0, 0], np.int16)}
    # The slot carries 60 nC, and so does a recharge phase of 60 µA for 1 ms.
    assert ask(warmed(), sequence(pair(600), recharge_us=1000, **back), START) == []
    assert ask(warmed(), sequence(pair(600), recharge_us=1002, **back), START) == ["reduces charge"]


def test_repetitions_are_judged_before_they_begin_and_ended_by_what_is_newer():
    made = sequence(twin(600, 30))
    assert ask(warmed(), made, START, 50) == []
    # Pass 51 begins less than a second after the end of pass 1, so both passes count.
    assert ask(warmed(), made, START, 51) == ["strong in a second"]
    oracle = warmed()
    assert ask(oracle, sequence(twin(600, 14)), START, 3) == []
    strong = [oracle.in_the_second_before(START + ns)[0][0] for ns in (0, 19_999_999, 20_000_000)]
    assert [int(each) for each in strong] == [14, 14, 28]
    assert ask(oracle, SILENT, START + 39_999_999) == []
    assert oracle.in_the_second_before(START + 90_000_000)[0][0] == 28


def test_time_of_a_session():
    made = sequence(pair(1), period=1_000_000)
    # The sequences of `warmed` have taken half a second of the session's 600 s.
    assert ask(warmed(), made, START, 601) == ["session time"]
    assert ask(warmed(), sequence([], period=1_000_000), START, 601) == []
    oracle = warmed()
    assert ask(oracle, made, START, 599) == []
    # Ten passes have begun; a new sequence or a restart cancels the others, which do not count.
    again = START + 10 * NS - 1
    assert ask(oracle, made, again, 590) == ["session time"]
    assert ask(oracle, made, again, 589) == []
    oracle.restart(START + 11 * NS - 2)
    # Eleven passes of 1 s and two runs of `warmed`, 0.5 s each, leave 588 s of 600 s.
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
    """Expected values are computed by hand from the definitions."""
    mouse = Bounds.of(display("electric-mouse"))
    assert (mouse.electrodes, mouse.charge_pc, mouse.total_ua) == (64, 500_000, 10_000)
    assert mouse.electrode_ua == (5000,) * 64
    assert (mouse.pulse_us, mouse.ramp_ns, mouse.late_rise) == (200, NS // 2, 200_000_000)
    assert (mouse.rounding_ua, mouse.session_us) == (33, 3600 * 10**6)
    # In single precision, half the threshold of 1.2 mA is just above 600 µA: rounded up, 601 µA.
    assert mouse.strong_ua == (601,) * 64
    assert mouse.recharge_ua == (120,) * 64
    assert 2400 < mouse.full_ua < Fraction(24_001, 10)
    # A disc of 0.5 mm diameter has 0.196 mm². At 100 µC/cm², its charge may be 0.196 µC.
    assert Bounds.of(display("small discs")).charge_pc == math.floor(math.pi / 16 * 10**6)
    ring = math.floor(math.pi / 4 * (1 - 0.85**2) * 10**6)
    assert Bounds.of(display("rings")).charge_pc == ring
    finger = Bounds.of(display("one finger"))
    assert finger.electrode_ua == (1900, 1100, 900, 1750, 1200, 2000, 777)
    assert (finger.total_ua, finger.strong_ua[2]) == (3333, 167)
    slow = Bounds.of(display("slow"))
    assert (slow.pulse_us, slow.rate_hz) == (150, Fraction(603, 10))


ORACLE = ("bounds", "quick", "oracle", "delivery_judge")
"""Modules of the oracle. Other modules of this folder compare the oracle with the gate."""
MAY = (
    "smarttouch.profile", "smarttouch.profile.electrodes", "smarttouch.emulator.firmware_base",
    "smarttouch.emulator.skin",
)  # fmt: skip
"""Modules of the package that the oracle may import: profiles, geometry, logs of emulators."""


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
