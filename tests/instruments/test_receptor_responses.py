"""Answers of each class: alone at its best, in its band, in proportion, and in time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError
from smarttouch.instruments.receptor_responses import SPAN_DB, split_trace
from smarttouch.instruments.skin_trace import SAMPLE_HZ, Trace, open_trace
from smarttouch.physiology.vibration_thresholds import threshold_um

from ..support.checks import raises

SILENT = 0.01
"""Drive of a class that is said to be silent."""


def drives(spec, seconds=2.0):
    return {
        afferent: each.drive.max()
        for afferent, each in split_trace(open_trace(spec, seconds)).items()
    }


@pytest.mark.parametrize(("spec", "alone"), [
    ("tone:30Hz,11um", Afferent.RA),  # 4.9 dB above threshold
    ("tone:250Hz,1.7um", Afferent.PC),
    ("tone:250Hz,9um", Afferent.PC),
    ("press:1N", Afferent.SAI),
])  # fmt: skip
def test_what_each_class_answers_best_drives_it_alone(spec, alone):
    for afferent, drive in drives(spec).items():
        if afferent is alone:
            assert drive > 0.9
        else:
            assert drive < SILENT, afferent


def test_a_slow_indentation_is_for_sai():
    time_s = np.arange(16000) / 4000
    pressed = np.where(np.abs(time_s - 2) < 1, 800.0, 0.0)
    answers = split_trace(Trace(pressed, np.zeros_like(pressed)))
    held = slice(7000, 9000)
    assert np.allclose(answers[Afferent.SAI].drive[held], 775 / 1475, atol=0.01)
    assert answers[Afferent.PC].drive[held].max() == 0
    # Both edges are felt by all.
    assert min(answers[each].drive[3900:4100].max() for each in Afferent) > 0.2


@pytest.mark.parametrize("afferent", [Afferent.RA, Afferent.PC])
@pytest.mark.parametrize("frequency_hz", [20, 30, 70, 250])
def test_drive_is_linear_in_decibels_above_threshold(afferent, frequency_hz):
    threshold = float(threshold_um(afferent, frequency_hz))
    for above_db in (-1, 1, 3, 6):
        spec = f"tone:{frequency_hz}Hz,{threshold * 10 ** (above_db / 20):.6f}um"
        answer = split_trace(open_trace(spec))[afferent]
        expected = min(1, max(0, above_db / SPAN_DB))
        assert np.median(answer.drive) == pytest.approx(expected, abs=0.01)


def mean_rate_hz(answer):
    return answer.rate_hz[answer.drive > 0].mean()


@pytest.mark.parametrize(
    ("afferent", "hz"), [(Afferent.RA, 25), (Afferent.RA, 60), (Afferent.PC, 217)]
)
def test_one_spike_each_cycle_at_the_same_phase(afferent, hz):
    answer = split_trace(open_trace(f"tone:{hz}Hz,8um"))[afferent]
    spikes = answer.spike_s[(answer.spike_s > 0.2) & (answer.spike_s < 1.8)]
    assert len(spikes) == pytest.approx(1.6 * hz, abs=1)
    assert np.ptp(np.mod(spikes * hz + 0.5, 1)) < 0.01
    assert mean_rate_hz(answer) == pytest.approx(hz, rel=0.01)


def test_sai_fires_faster_when_pressed_harder():
    rates = [split_trace(open_trace(f"press:{n}N"))[Afferent.SAI] for n in (0.1, 0.5, 1, 3)]
    found = [np.median(each.rate_hz) for each in rates]
    np.testing.assert_allclose(found, [10, 25, 50, 50], rtol=0.01)
    counts = [len(each.spike_s) for each in rates]
    assert counts == pytest.approx([20, 50, 99, 99], abs=2)


def test_who_answers_where_in_a_sweep():
    hz = 5 * 100 ** (np.arange(16000) / 16000)
    moved = 9 * np.sin(2 * np.pi * np.cumsum(hz) / SAMPLE_HZ)
    answers = split_trace(Trace(moved, np.zeros_like(moved)))
    bands = {each: hz[answers[each].drive > 0.02] for each in Afferent}
    # What 9 µm reach is just about the paper's band of RA, 20 to 70 Hz; PC comes in before.
    assert bands[Afferent.RA][[0, -1]] == pytest.approx([19, 72], rel=0.05)
    assert bands[Afferent.PC][0] == pytest.approx(34, rel=0.05)
    assert bands[Afferent.PC][-1] > 450
    assert not len(bands[Afferent.SAI])


@given(
    st.lists(st.floats(-1e5, 1e5), min_size=2, max_size=60),
    st.lists(st.floats(-50, 50), min_size=2, max_size=60),
    st.sampled_from([500.0, 4000.0]),
)
def test_any_trace_gives_drives_from_0_to_1_and_spikes_within_it(moved, pressed, sample_hz):
    size = min(len(moved), len(pressed))
    trace = Trace(np.array(moved[:size]), np.array(pressed[:size]), sample_hz)
    for answer in split_trace(trace).values():
        assert answer.drive.shape == answer.rate_hz.shape == (size,)
        assert ((answer.drive >= 0) & (answer.drive <= 1)).all()
        assert np.isfinite(answer.rate_hz).all()
        assert (np.diff(answer.spike_s) > 0).all()
        assert ((answer.spike_s >= 0) & (answer.spike_s < trace.duration_s)).all()


@settings(max_examples=20)
@given(st.integers(0, 99), st.floats(1.05, 5))
def test_more_of_the_same_drives_no_class_less(seed, factor):
    moved = np.random.default_rng(seed).normal(0, 4, 1200)
    trace = Trace(moved, np.full_like(moved, 0.2))
    more = Trace(trace.displacement_um * factor, trace.force_n * factor)
    before, after = split_trace(trace), split_trace(more)
    for afferent in Afferent:
        assert (after[afferent].drive >= before[afferent].drive - 1e-9).all()


def test_a_force_at_which_sai_is_full_before_it_answers_is_refused():
    with raises(ScheduleError, names="force.full_n", value=0.001):
        split_trace(open_trace("press:0.5N", 0.2), sai_full_n=0.001)
