"""Limits from one sequence to the next, by the ways in which the version before was beaten."""

import dataclasses

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, SafetyError, SequenceLateError
from smarttouch.boards.open import make_board
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..rising import open_level
from .by_hand import pulses, refused
from .gates import ManualClock

SECOND = 10**9


@pytest.mark.parametrize("times", [2.5, True, np.float64(2), "2"])
def test_repetitions_are_whole_numbers(limits, opened, times):
    gate, _ = opened
    assert refused(gate, pulses(1), times) == "times"
    with make_board("memory:", limits) as board:
        open_level(board.send, pulses(0), limits)
        with pytest.raises(BoardError, match="times"):
            board.send(pulses(1), times=times)
        board.send(pulses(1), times=np.int64(2))


def test_nearly_direct_current(opened):
    """One sign for 99.9 % of the time, by a phase that takes nothing back."""
    gate, _ = opened
    phase = np.zeros(64, np.int16)
    phase[[27, 28]] = 120, -120
    given = dataclasses.replace(pulses(1, period_us=16_906), recharge_ua=phase, recharge_us=16_666)
    assert refused(gate, given) == "duty"
    given = dataclasses.replace(given, recharge_us=2_000)
    assert refused(gate, given) == "recharge_ua"
    gate.prove(dataclasses.replace(given, recharge_ua=-phase))


def test_no_phase_is_the_first_current(limits):
    phase = np.zeros(64, np.int16)
    phase[[27, 28]] = 1, -1
    given = dataclasses.replace(
        pulses(1, current_ua=0), recharge_ua=phase, recharge_us=100, intensity=0.0
    )
    assert refused(SafetyGate(limits), given) == "recharge_ua"


@pytest.mark.parametrize("sign", [1, -1])
def test_net_current_of_any_second(opened, sign):
    """0.96 µC of one sign a pass: 52 of them in a second are 49.92 µC, and with a 53rd 50.88."""
    gate, clock = opened
    given = pulses(2, current_ua=sign * 2400, period_us=10_000)
    for step in range(52):
        gate.prove(dataclasses.replace(given, time_ns=SECOND + 1 + step))
        clock.time_ns += 10_000_000
    later = dataclasses.replace(given, time_ns=2 * SECOND)
    assert refused(gate, later) == "net_ma"
    # The other sign takes away from it, and does not make room for more of the newest.
    gate.prove(dataclasses.replace(pulses(2, current_ua=-sign * 2400), time_ns=2 * SECOND))
    assert refused(gate, dataclasses.replace(given, time_ns=3 * SECOND), times=2) == "net_ma"
    assert gate.dose.net_uc[27] == pytest.approx(sign * 51 * 0.96)
    clock.time_ns += SECOND
    gate.prove(dataclasses.replace(given, time_ns=3 * SECOND))


def test_a_new_session_waits_until_half_of_the_net_charge_is_free(opened):
    gate, clock = opened
    assert gate.net_rest_ns() == 0
    for step in range(30):
        gate.prove(pulses(2, time_ns=SECOND + 1 + step))
        clock.time_ns += 20_000_000
    gate.begin_session()
    # 26 passes of 0.96 µC are less than 25 µC: the fourth must leave. It ended 440 µs after its
    # start.
    rest_ns = gate.net_rest_ns()
    assert rest_ns == SECOND - 27 * 20_000_000 + 440_000
    clock.time_ns += rest_ns - 1
    assert gate.net_rest_ns() == 1
    clock.time_ns += 1
    assert gate.net_rest_ns() == 0


def test_repetitions_count_before_they_are_let_through(opened):
    gate, _ = opened
    given = pulses(2, period_us=19_000)
    # 53 of them would begin before the first has left the second.
    assert refused(gate, given, times=60) == "net_ma"
    gate.prove(given, times=52)


def test_full_in_one_scan_after_silence(limits):
    """Claimed intensity without current opens nothing."""
    clock = ManualClock()
    gate = SafetyGate(limits, clock)
    for step in range(100):
        clock.time_ns = step * 20_000_000
        intensity = min(1.0, step * 0.04)
        gate.prove(dataclasses.replace(pulses(0), intensity=intensity, time_ns=step * 20_000_000))
    assert refused(gate, pulses(1, time_ns=3 * SECOND)) == "ramp_s"


@pytest.mark.parametrize(("silent_s", "kept"), [(0.0, True), (14.9, True), (15.1, False)])
def test_a_level_stays_open_for_fifteen_seconds(opened, silent_s, kept):
    gate, clock = opened
    gate.prove(pulses(1))
    clock.time_ns += 20_000_000 + round(silent_s * SECOND)
    later = pulses(1, time_ns=SECOND + 20_000_000 + round(silent_s * SECOND))
    if kept:
        gate.prove(later)
    else:
        assert refused(gate, later) == "ramp_s"


def test_sequences_a_second(opened):
    """As fast as a program can, whatever period each claims."""
    gate, clock = opened
    sent = 0

    def hurry():
        nonlocal sent
        for step in range(4000):
            clock.time_ns += 250_000
            gate.prove(dataclasses.replace(pulses(0), time_ns=SECOND + 1 + step))
            sent += 1

    with pytest.raises(SafetyError) as error:
        hurry()
    # 200 Hz, and what 100 ms of lateness may put before its time; four had opened the level.
    assert (error.value.limit, sent) == ("rate_hz", 217)


def test_felt_pulses_of_a_true_second(opened):
    """Those of a sequence count until its last slot is over, not from its start alone."""
    gate, clock = opened
    given = pulses(60, current_ua=700, width_us=1, period_us=40_000, twin=True)
    for step in range(25):
        gate.prove(dataclasses.replace(given, time_ns=SECOND + 1 + step))
        clock.time_ns += 40_000_000
    # The first of them ends a little less than a second ago.
    assert refused(gate, dataclasses.replace(given, time_ns=3 * SECOND)) == "pulses_hz"
    # Its start waited for the end of the pass that opened the level.
    clock.time_ns += 19_999_000 + 60 * 21_000
    gate.prove(dataclasses.replace(given, time_ns=3 * SECOND))


def test_what_repeats_counts_over_opening_again(opened):
    gate, clock = opened
    gate.prove(pulses(60, current_ua=700, width_us=1, period_us=41_000, twin=True), times=1000)
    clock.time_ns += SECOND
    gate.begin_session()
    gate.prove(dataclasses.replace(pulses(0), intensity=0.0, time_ns=0))
    weak = dataclasses.replace(pulses(60, current_ua=300, width_us=1, twin=True), intensity=0.15)
    felt = dataclasses.replace(gate.limits, threshold_ma=0.5)
    assert felt.felt_ua.max() <= 300
    gate.prove(dataclasses.replace(weak, time_ns=1, period_us=40_000))
    found = gate._exposure._second_at_most
    assert found > 1_400 * 1_000_000


def test_masked_electrodes_carry_nothing():
    profile = load_profile("electric-mouse")
    output = profile.output.model_dump() | {"masked": (28, 40)}
    limits = SafetyLimits.of(
        type(profile).model_validate(profile.model_dump() | {"output": output})
    )
    assert limits.masked == (28, 40)
    assert limits.current_ua[[28, 40]].tolist() == limits.faint_ua[[28, 40]].tolist() == [0, 0]
    gate = SafetyGate(limits)
    open_level(gate.prove, pulses(0), limits)
    with pytest.raises(SafetyError) as error:
        gate.prove(pulses(1, current_ua=1))
    assert (error.value.limit, error.value.electrode) == ("current_ma", 28)


@pytest.mark.parametrize("away_s", [11, 1e9])
def test_a_due_time_of_another_clock(limits, away_s):
    board = make_board("memory:", limits)
    board.on_a_finger = True
    with board:
        due_ns = board.clock.now_ns() + round(away_s * SECOND)
        with pytest.raises(BoardError, match="due"):
            board.send(dataclasses.replace(pulses(0), intensity=0.0), due_ns=due_ns)
        with pytest.raises(SequenceLateError):
            board.send(dataclasses.replace(pulses(0), intensity=0.0), due_ns=0)
