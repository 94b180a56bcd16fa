"""Traces: from arrays, from CSV files, and written in a line."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SmartTouchError
from smarttouch.instruments.skin_trace import SAMPLE_HZ, open_trace

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


@pytest.mark.parametrize(("text", "about", "value"), [
    ("a,b\n1,2\n", "columns", ("a", "b")),
    ("time_s,amplitude_um\n1,2\n", "columns", ("time_s", "amplitude_um")),
    ("time_s,force_n\n0,1\n", "rows", 1),
    ("time_s,force_n\n0,1\n\n2,1\n1.5,1\n", "line", 5),
    ("time_s,force_n\n0,1\n700,1\n", "duration_s", 700),
])  # fmt: skip
def test_a_bad_file_is_reported_with_its_line(csv_file, text, about, value):
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


@pytest.mark.parametrize(("spec", "about", "value"), [
    ("tone:30Hz", "trace", "tone:30Hz"),
    ("tone:30Hz,8mm", "trace", "tone:30Hz,8mm"),
    ("tone:30Hz,8um+hum:3", "trace", "hum:3"),
    ("tone:-30Hz,8um", "trace", "tone:-30Hz,8um"),
    ("tone:0Hz,8um", "frequency", (0,)),
    ("tone:2000Hz,8um", "frequency", (2000,)),
    ("noise:60-400Hz,3um", "trace", "noise:60-400Hz,3um"),
    ("none.csv", "trace", "none.csv"),
])  # fmt: skip
def test_a_line_that_cannot_be_understood(spec, about, value):
    with raises(SmartTouchError, value=value):
        open_trace(spec)


@pytest.mark.parametrize("seconds", [0, -1, 601, float("nan")])
def test_impossible_lengths_are_refused(seconds):
    with raises(SmartTouchError, value=seconds):
        open_trace("press:1N", seconds)


@given(st.text(max_size=40))
def test_any_text_is_a_trace_or_refused(text):
    spec = f"tone:{text}"
    with contextlib.suppress(SmartTouchError):
        assert np.isfinite(open_trace(spec, 0.1).displacement_um).all()
