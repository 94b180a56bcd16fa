"""Limits of profiles, units, and successive sequences; expected values are computed by hand."""

import dataclasses

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, SafetyError, SequenceLateError
from smarttouch.boards.board import Board
from smarttouch.boards.open import make_board
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..support.scans import open_level
from .gate_under_test import ManualClock

SECOND = 10**9


def pulses(slots, *, current_ua=2400, width_us=200, period_us=20_000, time_ns=SECOND, twin=False):
    """Return slots that drive electrode 27 against 28; ``twin`` reverses every second slot."""
    current = np.zeros((slots, 64), np.int16)
    current[:, 27], current[:, 28] = current_ua, -current_ua
    if twin:
        current[1::2] *= -1
    one = np.ones(slots, np.uint16)
    return ScanSequence(current, one * width_us, one * 20, one * 27, period_us, 1.0, time_ns)


@pytest.fixture
def limits():
    return SafetyLimits.of(load_profile("electric-mouse"))


@pytest.fixture
def opened(limits):
    """Return a gate whose ramp has reached full intensity, and the gate's clock."""
    clock = ManualClock()
    gate = SafetyGate(limits, clock)
    open_level(gate.check, pulses(0), limits, clock=clock)
    return gate, clock


@pytest.mark.parametrize("kind", ["kajimoto61", "etactilekit"])
@pytest.mark.parametrize("ua_per_count", [0.00244, 0.00999, 2440.0])
def test_a_misread_unit(kind, ua_per_count):
    profile = load_profile({"kajimoto61": "kajimoto-61"}.get(kind, "etactilekit-32"))
    output = profile.output.model_copy(update={"ua_per_count": ua_per_count})
    with pytest.raises(BoardError):
        make_board(f"{kind}:/dev/nowhere", SafetyLimits.of(profile), output)


@pytest.mark.parametrize("times", [2.5, True, np.float64(2), "2"])
def test_repetitions_are_whole_numbers(limits, opened, times):
    gate, _ = opened
    with pytest.raises(SafetyError, match="times"):
        gate.prove(pulses(1), times)
    with make_board("memory:", limits) as board:
        open_level(board.send, pulses(0), limits)
        with pytest.raises(SafetyError, match="times"):
            board.send(pulses(1), times=times)
        board.send(pulses(1), times=np.int64(2))


def test_a_new_session_waits_until_half_of_the_net_charge_is_free(opened):
    gate, clock = opened
    assert gate.net_rest_ns() == 0
    for step in range(30):
        gate.check(pulses(2, time_ns=SECOND + 1 + step))
        clock.time_ns += 20_000_000
    gate.begin_session()
    # 26 passes of 0.96 µC stay below 25 µC, half of the limit. So the first 4 of the 30 passes must
    # be over a second old. The fourth ended 440 µs after its start.
    rest_ns = gate.net_rest_ns()
    assert rest_ns == SECOND - 27 * 20_000_000 + 440_000
    clock.time_ns += rest_ns - 1
    assert gate.net_rest_ns() == 1
    clock.time_ns += 1
    assert gate.net_rest_ns() == 0


def test_the_dose_is_time_charge_and_net_charge(opened):
    gate, _ = opened
    begun_s = gate.dose.seconds
    gate.check(pulses(3))
    gate.check(pulses(1, current_ua=-1200, time_ns=SECOND + 1))
    dose = gate.dose
    assert dose.seconds - begun_s == pytest.approx(0.04)
    # A pulse of 2.4 mA carries 0.48 µC.
    assert dose.charge_mc[27:30] == pytest.approx((1.68e-3, 1.68e-3, 0))
    assert dose.net_uc[27:30] == pytest.approx((1.2, -1.2, 0))
    assert dose.most_net_uc == pytest.approx(1.2)


def test_what_repeats_counts_over_opening_again(opened):
    gate, clock = opened
    gate.check(pulses(60, current_ua=700, width_us=1, period_us=41_000, twin=True), times=1000)
    clock.time_ns += SECOND
    gate.begin_session()
    gate.check(dataclasses.replace(pulses(0), intensity=0.0, time_ns=0))
    weak = dataclasses.replace(pulses(60, current_ua=300, width_us=1, twin=True), intensity=0.15)
    felt = dataclasses.replace(gate.limits, threshold_ma=0.5)
    assert felt.felt_ua.max() <= 300
    gate.check(dataclasses.replace(weak, time_ns=1, period_us=40_000))
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
    open_level(gate.check, pulses(0), limits)
    with pytest.raises(SafetyError) as error:
        gate.check(pulses(1, current_ua=1))
    assert (error.value.limit, error.value.electrode) == ("current_ma", 28)


@pytest.mark.parametrize("away_s", [11, 1e9])
def test_a_due_time_of_another_clock(limits, away_s):
    with Board(MemoryDriver("", limits), limits, claimed_time=True) as board:
        due_ns = board.clock.now_ns() + round(away_s * SECOND)
        with pytest.raises(BoardError, match="due"):
            board.send(dataclasses.replace(pulses(0), intensity=0.0), due_ns=due_ns)
        with pytest.raises(SequenceLateError):
            board.send(dataclasses.replace(pulses(0), intensity=0.0), due_ns=0)


@pytest.mark.parametrize("name", ["current_ua", "width_us", "discharge_us", "site"])
def test_what_is_changed_after_the_proof_changes_nothing(opened, name):
    gate, _ = opened
    made = pulses(1)
    copy = gate.check(made)
    array, before = getattr(copy, name), getattr(copy, name).tolist()
    getattr(made, name)[:] = 30_000
    assert array.tolist() == before
    assert not np.shares_memory(array, getattr(made, name))
    for write in (array.fill, array.view().fill):
        with pytest.raises(ValueError):
            write(0)
    with pytest.raises(ValueError):
        array.setflags(write=True)
    with pytest.raises(dataclasses.FrozenInstanceError):
        copy.period_us = 1
