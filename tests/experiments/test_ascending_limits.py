"""The procedures find what simulated subjects feel, and never go beyond what they may."""

import math
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.experiments.thresholds import MOST_HURRIED, AscendingLimits
from smarttouch.experiments.trials import STEP_S

from ..support.full import sample
from .simulated import SimulatedSubject

CEILING_MA = 5.0
FINGERS = int(os.environ.get("SMARTTOUCH_FINGERS", "40"))


class Rising:
    """Steps of ascending limits, one by one."""

    def __init__(self, ceiling_ma=CEILING_MA, expected_ma=1.2, **options):
        self.ceiling_ma = ceiling_ma
        self.course = AscendingLimits(ceiling_ma, expected_ma, **options).course()
        self.found = None
        self.level_ma = next(self.course)

    def answer(self, pressed):
        try:
            self.level_ma = self.course.send(bool(pressed))
            assert 0 <= self.level_ma <= self.ceiling_ma
        except StopIteration as end:
            self.found = end.value

    def until(self, level_ma):
        while self.level_ma < level_ma:
            self.answer(False)


def rise(subject, ceiling_ma=CEILING_MA, **options):
    rising = Rising(ceiling_ma, **options)
    while rising.found is None:
        rising.answer(subject.presses(rising.level_ma, STEP_S))
    return rising.found


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
    subject = SimulatedSubject(1.3, 2.0, slope=1e-6, guess=0, lapse=0, look_s=STEP_S)
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
    rising = Rising(fastest_ma_s=0.5)
    before, starts, felt, pressed = 0.0, 0, False, False
    while rising.found is None:
        assert rising.level_ma - before <= 0.5 * STEP_S + 1e-12
        starts += before == 0 < rising.level_ma
        felt = before > 0 and (felt or pressed)
        before = rising.level_ma
        pressed = rising.level_ma >= (2.0 if felt else 1.0)
        rising.answer(pressed)
    assert starts == rising.found.runs == 3


def test_a_run_whose_current_was_lost_begins_again_at_zero():
    rising = Rising()
    rising.until(1.0)
    assert rising.course.send(None) == 0


def test_keys_without_current_are_counted_and_restart_the_pause():
    rising = Rising(repeats=1)
    for _ in range(200):
        assert rising.level_ma == 0
        rising.answer(True)
    rising.until(1e-9)
    # Nobody reacts within a step of the first current.
    rising.answer(True)
    assert rising.level_ma == 0
    for level_ma in (1.0, 2.0):
        rising.until(level_ma)
        rising.answer(True)
    assert (rising.found.runs, rising.found.false_presses) == (1, 201)


def test_a_key_held_down_ends_the_run_at_zero_and_is_believed_in_the_end():
    """It may be a current that hurts: nothing more flows, and it is not asked for ever."""
    rising = Rising(repeats=1)
    for run in range(MOST_HURRIED + 1):
        rising.until(1.0)
        rising.answer(True)
        rising.answer(True)
        if run < MOST_HURRIED:
            assert rising.level_ma == 0
    assert rising.found is not None
    assert not rising.found.usable


@given(
    ceiling=st.floats(0.05, 5),
    expected=st.floats(0.05, 5),
    share=st.floats(0, 0.3),
    seed=st.integers(0, 2**31),
)
def test_whatever_is_pressed_it_ends_within_the_ceiling(ceiling, expected, share, seed):
    random = np.random.default_rng(seed)
    rising = Rising(ceiling, expected, seed=seed)
    for _ in range(20_000):
        if rising.found is not None:
            break
        # Whoever presses all the time never lets a run begin.
        rising.answer(rising.level_ma > 0 and random.random() < share)
    assert rising.found is not None or share > 0.02
    if rising.found is not None and rising.found.felt:
        assert 0 < rising.found.threshold_ma <= rising.found.comfort_ma <= ceiling
