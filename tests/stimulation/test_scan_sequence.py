"""Quantized kernels, slots as sums of kernels, and currents in integer µA."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Stimulus
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import (
    PEAK,
    KernelLists,
    KernelTable,
    largest_amplitude,
    peak_pc,
    quantized,
    round_charge_balanced,
)
from smarttouch.stimulation.slots import Slots, joined


def random_table(seed, kernels, electrodes):
    weights = np.random.default_rng(seed).normal(size=(kernels, electrodes))
    weights -= weights.mean(axis=1, keepdims=True)
    return KernelTable.of({Afferent.RA: weights}, {})


def slowly(table, pairs):
    """Return the currents for (kernel, amplitude) pairs, computed exactly by Python's integers."""
    made, carried, before = [], 0, 0
    for electrode in range(table.weights.shape[1]):
        carried += sum(int(table.weights[k, electrode]) * a for k, a in pairs)
        whole = (carried + 2**16) >> 17
        made.append(whole - before)
        before = whole
    return made


@given(st.integers(0, 9), st.lists(st.tuples(st.integers(0, 4), st.integers(0, 16_000)),
                                   min_size=1, max_size=4))  # fmt: skip
def test_currents_are_defined_to_the_bit(seed, pairs):
    table = random_table(seed, 5, 9)
    kernel, amplitude = np.array(pairs, np.uint16).T
    lists = KernelLists(table, np.array([0, len(pairs)]), kernel, amplitude)
    slots = joined(
        [Slots(lists.site, lists.current_ua, np.full(1, 200, np.uint16), sums=lists)] * 2
    )
    for made in (slots, slots.sums):
        assert made.current_ua.tolist() == [slowly(table, pairs)] * 2
        assert made.site.tolist() == [pairs[0][0]] * 2
    assert sum(slowly(table, pairs)) == 0


def test_kernels_sum_to_zero_and_have_one_peak():
    table = random_table(1, 40, 64)
    assert (table.weights.sum(axis=1, dtype=np.int64) == 0).all()
    assert (np.abs(table.weights.astype(int)).max(axis=1) == PEAK).all()
    assert not KernelTable.of({Afferent.RA: np.zeros((3, 3))}, {}).weights.any()


@given(st.lists(st.sampled_from([-1, -0.5, -0.3, -0.25, 0, 0.25, 0.3, 0.5, 1]), min_size=2))
def test_no_weight_is_above_the_peak_by_rounding(weights):
    whole = quantized(np.array([[*weights, -sum(weights)]])).astype(int)
    assert whole.sum() == 0
    assert np.abs(whole).max() in (0, PEAK)


@given(
    arrays(np.int16, st.tuples(st.integers(0, 4), st.just(3))),
    st.lists(st.integers(1, 200), min_size=4, max_size=4),
)
def test_the_largest_charge_is_that_of_the_strongest_pulse(current_ua, widths_us):
    pulses = list(zip(current_ua.tolist(), widths_us, strict=False))
    largest = max((abs(ua) * width_us for row, width_us in pulses for ua in row), default=0)
    assert peak_pc(current_ua, np.array(widths_us[: len(pulses)], np.uint16)) == largest


@given(st.integers(0, 50), st.integers(100, 5000))
def test_the_largest_amplitude_keeps_every_electrode_within_its_limit(seed, most_ua):
    table = random_table(seed, 6, 12)
    most = np.random.default_rng(seed).integers(most_ua // 2, most_ua + 1, 12).astype(float)
    kernel = np.arange(6, dtype=np.uint16)
    amplitude = largest_amplitude(table.weights, most)
    made = KernelLists(table, np.arange(7), kernel, amplitude).current_ua.astype(int)
    assert (np.abs(made) <= most).all()
    assert (np.abs(made).max(axis=1) >= most.min() - 2).all()


@pytest.mark.parametrize("scan", ["points", "auto"])
def test_sequences_are_sums_and_proved_as_such(scan):
    profile = load_profile("electric-mouse")
    bank, gate = load_bank(profile), SafetyGate(SafetyLimits.of(profile))
    plain = Pipeline(profile, bank, RunConfig(scan=scan))
    whole = Pipeline(profile, bank, RunConfig(scan=scan), in_sums=True)
    rng = np.random.default_rng(0)
    for step in range(8):
        active = np.zeros((3, 64), np.float32)
        active[0, rng.choice(64, 20)] = rng.uniform(0.1, 1, 20)
        given = Stimulus(active, step * 10**8, 5.0)
        before, sequence = plain.process(given).sequence, whole.process(given).sequence
        gate.check(sequence)
        assert sequence.sums.table is whole.table
        np.testing.assert_array_equal(sequence.sums.current_ua, sequence.current_ua)
        if before.current_ua.shape == sequence.current_ua.shape:
            # `before` has rounding errors at other electrodes, so its currents differ.
            np.testing.assert_allclose(sequence.current_ua, before.current_ua, atol=12)
        if (proof := sequence.proof) is not None:
            assert np.maximum(proof.off_target, proof.spill)[proof.points > 1].max(initial=0) <= 0.3


@given(st.integers(0, 6), st.integers(1, 80), st.integers(0, 2**32 - 1), st.floats(0, 5000))
def test_whole_currents_sum_to_zero_and_none_is_off_by_one(slots, electrodes, seed, most_ua):
    current_ua = np.random.default_rng(seed).uniform(-1, 1, (slots, electrodes))
    current_ua -= current_ua.mean(axis=1, keepdims=True)
    current_ua *= most_ua / 2
    whole = round_charge_balanced(current_ua)
    assert whole.dtype == np.int16
    assert not whole.sum(axis=1).any()
    assert (np.abs(whole - current_ua) < 1).all()
