"""Traces from files or a line of text, and the response of each class of receptors."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ScheduleError, SmartTouchError
from smarttouch.instruments.vibration_trace import (
    SAMPLE_HZ,
    SPAN_DB,
    Trace,
    open_trace,
    split_trace,
)
from smarttouch.physiology.vibration_thresholds import threshold_um

from ..support.checks import raises


@pytest.fixture
def csv_file(tmp_path):
    def write(text, name="trace.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_text(text, encoding=encoding)
        return str(path)

    return write


def test_uneven_samples_become_even_ones(csv_file):
    time_s = 5 + np.cumsum(np.random.default_rng(1).uniform(0.0002, 0.0008, 2000))
    rows = np.column_stack([time_s, np.sin(40 * time_s), 2 * time_s])
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    trace = open_trace(csv_file("\n".join(["time_s,displacement_um,force_n", *lines])))
    assert trace.sample_hz == SAMPLE_HZ
    assert trace.duration_s == pytest.approx(np.ptp(time_s), abs=1 / SAMPLE_HZ)
    np.testing.assert_allclose(trace.displacement_um, np.sin(40 * (trace.time_s + time_s[0])),
                               atol=2e-4)  # fmt: skip
    np.testing.assert_allclose(trace.force_n, 2 * (trace.time_s + time_s[0]))


def test_finer_samples_are_kept(csv_file):
    lines = [f"{number / 10_000},{number}" for number in range(4000)]
    trace = open_trace(csv_file("\n".join(["time_s,displacement_um", *lines])))
    assert trace.sample_hz == pytest.approx(10_000)
    assert len(trace.force_n) == 4000
    assert not trace.force_n.any()


def test_a_file_of_force_and_displacement(csv_file):
    path = csv_file("\ufefftime_s, force_n,note,displacement_um\n0,0,a,0\n\n0.5,1,b,100\n1,1,c,0\n")
    trace = open_trace(path)
    assert (trace.title, trace.duration_s) == (path, pytest.approx(1.00025))
    assert trace.force_n[[0, 1000, 2000]] == pytest.approx([0, 0.5, 1])
    assert trace.displacement_um[[1000, 3000]] == pytest.approx([50, 50])


@pytest.mark.parametrize(("text", "value"), [
    ("a,b\n1,2\n", ("a", "b")),
    ("time_s,amplitude_um\n1,2\n2,2\n", ("time_s", "displacement_um")),
    ("time_s,force_n\n0,1\n", 1),
    ("time_s,force_n\n0,1\n\n2,1\n1.5,1\n", 5),
    ("time_s,force_n\n0,1\n700,1\n", 700),
])  # fmt: skip
def test_a_bad_file_is_reported_with_its_line(csv_file, text, value):
    path = csv_file(text)
    with raises(SmartTouchError, value=value) as caught:
        open_trace(path)
    assert path in str(caught.value)


def test_a_line_is_the_sum_of_its_parts():
    both = open_trace("tone:30Hz,8um+press:0.5N", 1.0)
    tone, press = open_trace("tone:30Hz,8um", 1.0), open_trace("PRESS: 0.5 N", 1.0)
    np.testing.assert_array_equal(both.displacement_um, tone.displacement_um)
    np.testing.assert_array_equal(both.force_n, press.force_n)
    middle = slice(400, 3600)
    expected = 8 * np.sin(60 * np.pi * both.time_s)
    np.testing.assert_allclose(both.displacement_um[middle], expected[middle], atol=1e-9)
    np.testing.assert_allclose(both.force_n[middle], 0.5)


def test_a_line_begins_and_ends_smoothly():
    force = open_trace("press:1N", 1.0).force_n
    assert not force[0]
    assert force[[100, 2000, 3900]] == pytest.approx([0.5, 1, 0.5])
    assert np.abs(np.diff(force)).max() < 0.01


@pytest.mark.parametrize(("spec", "seconds", "value"), [
    *((spec, 1.0, spec) for spec in
      ("tone:30Hz", "tone:30Hz,8mm", "tone:-30Hz,8um", "noise:60-400Hz,3um", "none.csv")),
    ("tone:30Hz,8um+hum:3", 1.0, "hum:3"), ("tone:0Hz,8um", 1.0, 0), ("tone:2000Hz,8um", 1.0, 2000),
    *(("press:1N", seconds, seconds) for seconds in (0, -1, 601, float("nan"))),
])  # fmt: skip
def test_a_line_that_cannot_be_understood(spec, seconds, value):
    with raises(SmartTouchError, value=value):
        open_trace(spec, seconds)


@given(st.text(max_size=40))
def test_any_text_is_a_trace_or_refused(text):
    spec = f"tone:{text}"
    with contextlib.suppress(SmartTouchError):
        assert np.isfinite(open_trace(spec, 0.1).displacement_um).all()


SILENT = 0.01
"""Largest drive at which a class counts as silent."""


def drives(spec, seconds=2.0):
    return {
        afferent: each.drive.max()
        for afferent, each in split_trace(open_trace(spec, seconds)).items()
    }


@pytest.mark.parametrize(("spec", "alone"), [
    ("tone:30Hz,11um", Afferent.RA),  # 11 µm is 4.9 dB above the threshold
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
    # All classes respond to the edge, at 1 s.
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


@pytest.mark.parametrize(
    ("afferent", "hz"), [(Afferent.RA, 25), (Afferent.RA, 60), (Afferent.PC, 217)]
)
def test_one_spike_each_cycle_at_the_same_phase(afferent, hz):
    answer = split_trace(open_trace(f"tone:{hz}Hz,8um"))[afferent]
    spikes = answer.spike_s[(answer.spike_s > 0.2) & (answer.spike_s < 1.8)]
    assert len(spikes) == pytest.approx(1.6 * hz, abs=1)
    assert np.ptp(np.mod(spikes * hz + 0.5, 1)) < 0.01
    assert answer.rate_hz[answer.drive > 0].mean() == pytest.approx(hz, rel=0.01)


def test_sai_fires_faster_when_pressed_harder():
    rates = [split_trace(open_trace(f"press:{n}N"))[Afferent.SAI] for n in (0.1, 0.5, 1, 3)]
    found = [np.median(each.rate_hz) for each in rates]
    np.testing.assert_allclose(found, [10, 25, 50, 50], rtol=0.01)
    counts = [len(each.spike_s) for each in rates]
    assert counts == pytest.approx([20, 50, 99, 99], abs=2)


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


def test_a_force_at_which_sai_is_full_before_it_answers_is_refused():
    with raises(ScheduleError, names="force.full_n", value=0.001):
        split_trace(open_trace("press:0.5N", 0.2), sai_full_n=0.001)
