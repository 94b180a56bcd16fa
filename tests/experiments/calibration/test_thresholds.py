"""The procedures find what simulated subjects feel, and never go beyond what they may."""

import math
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.experiments.calibration.threshold_procedures import (
    MOST_HURRIED,
    TICK_S,
    AscendingLimits,
)

from ...whole import sample
from .subject import SimulatedSubject

CEILING_MA = 5.0
FINGERS = int(os.environ.get("SMARTTOUCH_FINGERS", "40"))


def rise(subject, ceiling_ma=CEILING_MA, **options):
    procedure = AscendingLimits(ceiling_ma, 1.2, **options)
    while not procedure.done:
        level = procedure.next()
        assert 0 <= level <= ceiling_ma
        procedure.answer(subject.presses(level, TICK_S))
    return procedure.result()


KINDS = {
    "usual": {}, "steep": {"slope": 0.05}, "shallow": {"slope": 0.2}, "drifting": {"drift": 0.03},
    "slow": {"reaction_s": 0.6}, "careless": {"guess": 0.02, "lapse": 0.05},
}  # fmt: skip


@pytest.mark.parametrize("kind", sample(KINDS))
def test_bias_and_spread_over_many_subjects(kind):
    """Thresholds from 0.6 to 2.4 mA where 1.2 mA are expected."""
    rising, comfort = [], []
    for seed in range(FINGERS if kind == "usual" else 40):
        random = np.random.default_rng(seed)
        threshold = 1.2 * math.exp(0.25 * random.standard_normal())
        strongest = min(threshold * random.uniform(1.5, 2.2), 4.5)
        subject = SimulatedSubject(threshold, strongest, seed=seed, **KINDS[kind])
        found = rise(subject, seed=seed)
        rising.append(found.threshold_ma / threshold - 1)
        comfort.append(found.comfort_ma / strongest - 1)
    for name, off in ("rising", rising), ("comfort", comfort):
        print(f"{kind}, {len(off)} fingers, {name}: off by {np.mean(off):+.1%} ± {np.std(off):.1%}")
    # Measured, rising: bias −3 to +7 %, spread 4 to 9 %; comfort −11 to +2 %, 3 to 9 %.
    assert abs(np.mean(rising)) < 0.1
    assert np.std(rising) < 0.11
    assert -0.13 < np.mean(comfort) < 0.03
    assert np.std(comfort) < 0.1


def test_a_subject_without_noise_is_found_to_a_step():
    subject = SimulatedSubject(1.3, 2.0, slope=1e-6, guess=0, lapse=0, look_s=TICK_S)
    found = rise(subject)
    assert found.threshold_ma == pytest.approx(1.3, abs=0.06)
    assert found.comfort_ma == pytest.approx(2.0, abs=0.06)
    assert (found.runs, found.false_presses) == (3, 0)
    assert found.spread < 0.03


def test_an_electrode_never_felt_is_not_tried_again():
    found = rise(SimulatedSubject(50.0, 90.0, guess=0), ceiling_ma=2.0)
    assert not found.felt
    assert not found.usable
    assert found.runs == 1


def test_what_is_never_enough_is_comfortable_to_the_ceiling():
    found = rise(SimulatedSubject(1.0, 90.0, guess=0), ceiling_ma=2.0)
    assert found.comfort_ma == 2.0
    assert found.usable


def test_runs_that_differ_are_made_again():
    subject = SimulatedSubject(1.2, 2.4, slope=0.5, seed=7)
    assert rise(subject, seed=7).runs == 5


def test_rises_from_zero_in_small_steps_no_faster_than_allowed():
    procedure = AscendingLimits(5.0, 1.2, fastest_ma_s=0.5)
    before, starts = 0.0, 0
    while len(procedure.runs) < 2:
        level = procedure.next()
        assert level - before <= 0.5 * TICK_S + 1e-12
        starts += before == 0 < level
        before = level
        procedure.answer(level >= (2.0 if procedure.felt else 1.0))
    assert starts >= 2


def until(procedure, level_ma):
    while procedure.next() < level_ma:
        procedure.answer(False)


def test_keys_without_current_are_counted_and_restart_the_pause():
    procedure = AscendingLimits(5.0, 1.2)
    for _ in range(200):
        assert procedure.next() == 0
        procedure.answer(True)
    assert procedure.false_presses == 200
    until(procedure, 1.0)
    # Nobody reacts within a step of the first current.
    fresh = AscendingLimits(5.0, 1.2)
    until(fresh, 1e-9)
    fresh.answer(True)
    assert fresh.false_presses == 1
    assert fresh.next() == 0


def test_a_key_held_down_ends_the_run_at_zero_and_is_believed_in_the_end():
    """It may be a current that hurts: nothing more flows, and it is not asked for ever."""
    procedure = AscendingLimits(5.0, 1.2, repeats=1)
    for run in range(MOST_HURRIED + 1):
        until(procedure, 1.0)
        procedure.answer(True)
        procedure.next()
        procedure.answer(True)
        if run < MOST_HURRIED:
            assert procedure.next() == 0
    assert procedure.done
    assert not procedure.result().usable


@given(
    ceiling=st.floats(0.05, 5),
    expected=st.floats(0.05, 5),
    share=st.floats(0, 0.3),
    seed=st.integers(0, 2**31),
)
def test_whatever_is_pressed_it_ends_within_the_ceiling(ceiling, expected, share, seed):
    random = np.random.default_rng(seed)
    procedure = AscendingLimits(ceiling, expected, seed=seed)
    for _ in range(20_000):
        if procedure.done:
            break
        level = procedure.next()
        assert 0 <= level <= ceiling
        # Whoever presses all the time never lets a run begin.
        procedure.answer(level > 0 and bool(random.random() < share))
    assert procedure.done or share > 0.02
    found = procedure.result()
    if procedure.done and found.felt:
        assert 0 < found.threshold_ma <= found.comfort_ma <= ceiling
