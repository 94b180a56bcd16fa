"""Traces: from arrays, from CSV files, and written in a line."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.errors import SmartTouchError
from smarttouch.vibrotactile.spec import is_spec, open_trace
from smarttouch.vibrotactile.trace import SAMPLE_HZ, Trace, sampled


@pytest.fixture
def csv_file(tmp_path):
    def write(text, name="trace.csv", encoding="utf-8"):
        path = tmp_path / name
        path.write_text(text, encoding=encoding)
        return str(path)

    return write


def test_uneven_samples_become_even_ones():
    time_s = 5 + np.cumsum(np.random.default_rng(1).uniform(0.0002, 0.0008, 2000))
    trace = sampled(time_s, np.sin(40 * time_s), 2 * time_s)
    assert trace.sample_hz == SAMPLE_HZ
    assert trace.duration_s == pytest.approx(np.ptp(time_s), abs=1 / SAMPLE_HZ)
    np.testing.assert_allclose(trace.displacement_um, np.sin(40 * (trace.time_s + time_s[0])),
                               atol=2e-4)  # fmt: skip
    np.testing.assert_allclose(trace.force_n, 2 * (trace.time_s + time_s[0]))


def test_finer_samples_are_kept():
    time_s = np.arange(4000) / 10_000
    trace = sampled(time_s, np.sin(time_s))
    assert trace.sample_hz == pytest.approx(10_000)
    assert len(trace.force_n) == 4000
    assert not trace.force_n.any()


@pytest.mark.parametrize(
    ("time_s", "moved", "says"),
    [
        ([0, 1, 1], [0, 0, 0], "sample 2 at 1 s does not"),
        ([0, np.nan, 1], [0, 0, 0], "times must rise"),
        ([0], [0], "1 times"),
        ([0, 1], [0, 0, 0], "2 times for 3"),
        ([0, 601], [0, 0], "at most 600"),
        ([0, 1], [0, np.inf], "not a finite number"),
    ],
)
def test_arrays_that_are_no_trace_are_refused(time_s, moved, says):
    with pytest.raises(SmartTouchError, match=says):
        sampled(time_s, moved)


def test_a_trace_has_as_many_forces_as_displacements():
    with pytest.raises(SmartTouchError, match="as many of both"):
        Trace(np.zeros(3), np.zeros(4))


def test_a_file_of_force_and_displacement(csv_file):
    path = csv_file("\ufefftime_s, force_n,note,displacement_um\n0,0,a,0\n\n0.5,1,b,100\n1,1,c,0\n")
    trace = open_trace(path)
    assert (trace.title, trace.duration_s) == (path, pytest.approx(1.00025))
    assert trace.force_n[[0, 1000, 2000]] == pytest.approx([0, 0.5, 1])
    assert trace.displacement_um[[1000, 3000]] == pytest.approx([50, 50])


def test_a_spectrum_sounds_as_long_as_is_asked(csv_file):
    path = csv_file("frequency_hz,amplitude_um,phase_deg\n30,8,0\n250,2,90\n")
    trace = open_trace(path, seconds=0.5)
    assert trace.duration_s == 0.5
    time = trace.time_s
    expected = 8 * np.cos(60 * np.pi * time) - 2 * np.sin(500 * np.pi * time)
    np.testing.assert_allclose(trace.displacement_um, expected, atol=1e-9)


def test_phases_that_a_spectrum_has_not_follow_the_seed(csv_file):
    path = csv_file("frequency_hz,amplitude_um\n30,8\n40,8\n")
    first, same, other = (open_trace(path, 0.1, seed).displacement_um for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, same)
    assert np.abs(first - other).max() > 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1: the columns are none"),
        ("a,b\n1,2\n", "line 1: the columns are a, b: name them"),
        ("time_s,amplitude_um\n1,2\n", "line 1"),
        ("frequency_hz,phase_deg\n1,2\n", "line 1"),
        ("time_s,force_n\n0,1\n", "has 1 rows of numbers: give 2"),
        ("time_s,force_n\n0,1\n\n1,x\n", "line 4: 'x' is not a number"),
        ("time_s,force_n\n0,1\n1\n", "line 3: '' is not a number"),
        ("time_s,force_n\n0,1\n1,nan\n", "line 3: 'nan'"),
        ("time_s,force_n\n0,1\n\n2,1\n1.5,1\n", "line 5: time_s 1.5 is not after the 2"),
        ("frequency_hz,amplitude_um\n30,1\n40,-1\n", "line 3: -1 µm at 40 Hz"),
        ("frequency_hz,amplitude_um\n9000,1\n", "line 2: 1 µm at 9000 Hz"),
        ("time_s,force_n\n0,1\n700,1\n", "lasts 700 s"),
    ],
)
def test_a_bad_file_is_told_with_its_line(csv_file, text, says):
    with pytest.raises(SmartTouchError, match=says):
        open_trace(csv_file(text))


def test_files_that_cannot_be_read(csv_file, tmp_path):
    with pytest.raises(SmartTouchError, match="neither a file nor a trace in a line: write"):
        open_trace(str(tmp_path / "none.csv"))
    with pytest.raises(SmartTouchError, match=f"{tmp_path} is a folder"):
        open_trace(str(tmp_path))
    with pytest.raises(SmartTouchError, match="not a text in UTF-8"):
        open_trace(csv_file("time_s,µ", encoding="latin-1"))


def test_a_line_is_the_sum_of_its_parts():
    both = open_trace("tone:30Hz,8um+press:0.5N", 1.0)
    tone, press = open_trace("tone:30Hz,8um", 1.0), open_trace("PRESS: 0.5 N", 1.0)
    np.testing.assert_array_equal(both.displacement_um, tone.displacement_um)
    np.testing.assert_array_equal(both.force_n, press.force_n)
    middle = slice(400, 3600)
    expected = 8 * np.sin(60 * np.pi * both.time_s)
    np.testing.assert_allclose(both.displacement_um[middle], expected[middle], atol=1e-9)
    np.testing.assert_allclose(both.force_n[middle], 0.5)


def test_parts_begin_and_end_smoothly_when_they_should():
    force = open_trace("press:1N@0.25-0.75", 1.0).force_n
    assert not force[:1000].any()
    assert not force[3001:].any()
    assert force[1100] == pytest.approx(0.5)
    assert np.abs(np.diff(force)).max() < 0.01


def test_noise_keeps_to_its_band_and_seed():
    wave = open_trace("noise:60-400Hz,3um", 2.0, 7).displacement_um
    assert wave[400:-400].std() == pytest.approx(3, rel=0.05)
    spectrum = np.abs(np.fft.rfft(wave)) ** 2
    hz = np.fft.rfftfreq(len(wave), 1 / SAMPLE_HZ)
    assert spectrum[(hz > 55) & (hz < 405)].sum() > 0.999 * spectrum.sum()
    np.testing.assert_array_equal(wave, open_trace("noise:60-400Hz,3µm", 2.0, 7).displacement_um)


def test_a_sweep_passes_its_middle_at_half_time():
    wave = open_trace("sweep:10-160Hz,5um", 2.0).displacement_um
    rises = np.flatnonzero((wave[:-1] < 0) & (wave[1:] >= 0)) / SAMPLE_HZ
    interval = np.diff(rises)[np.searchsorted(rises, 1.0) - 1]
    assert 1 / interval == pytest.approx(40, rel=0.05)


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("tone:30Hz", "'tone:30Hz' is no part of a trace: write"),
        ("tone:30Hz,8mm", "no part"),
        ("tone:30Hz,8um+hum:3", "'hum:3' is no part"),
        ("tone:-30Hz,8um", "no part"),
        ("tone:0Hz,8um", "frequencies must be above 0"),
        ("tone:2000Hz,8um", "at most 1000 Hz"),
        ("sweep:100-50Hz,8um", "lower one first"),
        ("press:1N@2-1", "let it end after it begins"),
        ("press:1N@0-9", "the trace 2 s"),
        ("noise:50.1-50.2Hz,1um", "too narrow a band"),
    ],
)
def test_a_line_that_cannot_be_understood(spec, says):
    with pytest.raises(SmartTouchError, match=says):
        open_trace(spec)


@pytest.mark.parametrize("seconds", [0, -1, 601, float("nan")])
def test_impossible_lengths_are_refused(seconds):
    with pytest.raises(SmartTouchError, match="are not possible"):
        open_trace("press:1N", seconds)


@given(st.text(max_size=40))
def test_any_text_is_a_trace_or_refused(text):
    spec = f"tone:{text}"
    assert is_spec(spec)
    with contextlib.suppress(SmartTouchError):
        assert np.isfinite(open_trace(spec, 0.1).displacement_um).all()
