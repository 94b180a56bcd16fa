"""Tests of force sources: stated force, and load cells that send text or packets."""

import math
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SourceError
from smarttouch.sources import force as forces
from smarttouch.sources.force import FRESH_S, CellWatch, open_cell, open_force
from smarttouch.sources.serial_sensors import (
    LONGEST_LINE,
    TextReadings,
    encode_force,
    parse_line,
)
from smarttouch.testing.source_contracts import ForceContract

from ..support.checks import numbers_in, raises
from ..support.runs import until


@pytest.mark.parametrize(("text", "force_n"), [("0", 0), ("0.5", 0.5), ("20", 20)])
def test_fixed_force(profile, text, force_n):
    with open_force(f"fixed:{text}", profile) as source:
        assert source.read(0) == source.read(10**12) == force_n
        assert source.title == f"fixed {force_n:g} N"
        assert source.notes == []


@pytest.mark.parametrize(("url", "value", "allowed"), [
    *((f"fixed:{text}", text, 20) for text in ("", "x", "-0.1", "20.1", "nan", "inf", "0.5 N")),
    ("spring:1", "spring:1", ("fixed", "hx711", "loadcell")),
    ("hx711:/dev/nowhere", "electric-mouse", "smarttouch calibrate force"),
])  # fmt: skip
def test_what_is_no_force(profile, url, value, allowed):
    with raises(SourceError, names="force", value=value, allowed=allowed):
        open_force(url, profile)


@pytest.fixture
def in_grams(profile, changed):
    """Return the profile with a force curve for readings in grams."""
    return changed(profile, {"force.curve": (0.0, 0.00980665)})


def grams(least):
    """Return a function that makes lines of a load cell: ``least`` and ``least`` + 1 g in turn."""
    return lambda number: b"Reading: %d g\r\n" % (least + number % 2)


class TestSources(ForceContract):
    """Contract tests of ``fixed:`` and ``hx711:``."""

    @pytest.fixture(params=["fixed:0.5", "hx711"])
    def url(self, request, make_device):
        if request.param == "hx711":
            return f"hx711:{make_device(grams(50)).line.name}?baud=115200"
        return request.param

    @pytest.fixture(autouse=True)
    def _opened(self, url, in_grams):
        self.make = lambda _: open_force(url, in_grams)


SECOND = 10**9


@pytest.mark.parametrize(("line", "reading"), [
    (b"Reading: 12.34 g", 12.34), (b"-8388608", -8388608), (b"HX711 reading: -77", -77),
    (b"one reading:\t4.5\t| average:\t4.6", 4.5), (b"0.00 kg", 0),
    (b"Load_cell output val: +.5", 0.5), (b"Weight:-4.5g", -4.5), (b"1.5e3", 1500), (b"12,5", 12),
    (b"", None), (b"HX711 not found.", None), (b"1.2.3", None), (b"--3", None),
    (b"information", None), (b"\xff12", None), (b"1\x002", None),
    *((each, math.nan) for each in
      (b"nan", b"Reading: NaN g", b"-inf", b"ovf", b"1e10", b"9" * 400, b"nan 3")),
])  # fmt: skip
def test_lines(line, reading):
    assert parse_line(line) == (reading and pytest.approx(reading, nan_ok=True))


@given(st.lists(st.binary(max_size=50), max_size=10), st.floats(-1e6, 1e6))
def test_no_text_crashes_and_a_reading_after_it_is_found(pieces, value):
    readings = TextReadings()
    for piece in pieces:
        readings.feed(piece)
    readings.feed(b"\r\n1\r\n")
    assert readings.feed(f"Reading: {value!r} g\r\n".encode()) == [value]


@pytest.mark.parametrize(("text", "came", "garbled", "last"), [
    # The first line is ignored, because its start may be missing.
    (b"345\n12345\n", [12345], 0, ""),
    # A line that ends with a colon is a label; other lines without a number are garbled.
    (b"\nHX711 reading:\n5\n\nHX711 not found.\n6\n", [5, 6], 1, "'HX711 not found.'"),
    # The first number after bytes that are not text is ignored.
    (b"\n\xfe\x01\n7\n\x80\n8\n\x90\n1\n2\n3\n", [2, 3], 3, None),
])  # fmt: skip
def test_what_is_read_of_a_text(text, came, garbled, last):
    readings = TextReadings()
    assert readings.feed(text) == came
    assert readings.garbled == garbled
    assert last is None or readings.last_garbled == last
    readings.restart()
    assert readings.feed(b"345\n") == []


def test_a_line_without_end_is_forgotten():
    readings = TextReadings()
    readings.feed(b"\n")
    for _ in range(3):
        assert readings.feed(b"1" * LONGEST_LINE) == []
    assert readings.garbled == 1
    assert readings.feed(b"1\n5\n6\n") == [6]


class TestWatch:
    """Tests of `CellWatch`, in simulated time."""

    @pytest.fixture
    def notes(self):
        return []

    @pytest.fixture
    def watch(self, notes):
        return CellWatch("cell", notes, presses=lambda reading: reading > 100)

    def stand_still(self, watch, value, seconds, rate_hz=80, start_s=0.0):
        """Add equal readings for some seconds; return the time of the last one, ns."""
        for k in range(round(seconds * rate_hz) + 1):
            now_ns = round((start_s + k / rate_hz) * SECOND)
            watch.take([value], now_ns)
        return now_ns

    def test_a_reading_counts_while_it_is_fresh(self, watch, notes):
        watch.take([1, 2, 3], 0)
        fresh_ns = round(FRESH_S * SECOND)
        assert watch.reading(fresh_ns) == 3
        assert math.isnan(watch.reading(fresh_ns + 1))
        watch.take([], fresh_ns + 1)
        watch.take([], 2 * SECOND)
        watch.take([4], 3 * SECOND)
        assert watch.reading(3 * SECOND) == 4
        (note,) = notes
        assert numbers_in(note) == [3.0, FRESH_S]
        watch.take([], 4 * SECOND)
        watch.take([5], 4 * SECOND)
        (note,) = notes
        assert numbers_in(note) == [3.0, FRESH_S], "the note does not name the longest pause"

    @pytest.mark.parametrize("invalid", [math.nan, 2.0**23 - 1, -(2.0**23)])
    def test_a_cell_that_reports_no_reading(self, watch, notes, invalid):
        watch.take([200, invalid], 0)
        assert math.isnan(watch.reading(0))
        watch.take([invalid], 1)
        assert math.isnan(watch.reading(1))
        watch.take([201], 2)
        assert watch.reading(2) == 201
        (note,) = notes
        assert numbers_in(note) == [2]

    def test_frozen_under_pressure(self, watch, notes):
        now_ns = self.stand_still(watch, 150.0, 1.9)
        assert watch.reading(now_ns) == 150
        now_ns = self.stand_still(watch, 150.0, 3.0, start_s=2.0)
        assert math.isnan(watch.reading(now_ns))
        watch.take([151.0], 6 * SECOND)
        assert watch.reading(6 * SECOND) == 151
        assert len(notes) == 2
        assert any("did not change" in note for note in notes)

    def test_slow_cells_need_twenty(self, watch):
        now_ns = self.stand_still(watch, 150.0, 5.9, rate_hz=3)
        assert watch.reading(now_ns) == 150
        watch.take([150.0], now_ns + SECOND // 3)
        watch.take([150.0], now_ns + SECOND // 3)
        assert math.isnan(watch.reading(now_ns + SECOND // 3))

    def test_neither_rest_nor_noise_is_frozen(self, watch, notes):
        now_ns = self.stand_still(watch, 0.0, 10)
        assert watch.reading(now_ns) == 0
        for k in range(400):
            watch.take([150.0 + k % 2], now_ns + k * SECOND // 80)
        assert watch.reading(now_ns + 5 * SECOND) == 151
        assert notes == []

    def test_gone_and_back(self, watch, notes):
        watch.take([1.0], 0)
        watch.lose(SECOND)
        assert math.isnan(watch.reading(SECOND))
        watch.lose(2 * SECOND)
        assert [numbers_in(note) for note in notes] == [[2.0, FRESH_S]]
        watch.take([], 3 * SECOND)
        assert [numbers_in(note) for note in notes] == [[3.0, FRESH_S]]
        watch.take([2.0], 4 * SECOND)
        assert watch.reading(4 * SECOND) == 2
        assert [numbers_in(note) for note in notes] == [[4.0, FRESH_S]]

    def test_garbage_is_noted_once(self, watch, notes):
        watch.take([], 0, 1, "'x'")
        (note,) = notes
        assert "'x'" in note
        watch.take([], 0, 24, "'y'")
        (note,) = notes
        assert "'y'" in note
        assert numbers_in(note) == [24]


@pytest.mark.parametrize(("kind", "data"), [
    ("hx711", grams(50)),
    ("loadcell", lambda number: encode_force(number, 0, 50 + number % 2)),
])  # fmt: skip
def test_newtons_and_raw_readings_from_a_port(make_device, in_grams, kind, data):
    cell = make_device(data)
    url = f"{kind}:{cell.line.name}"
    with open_force(url, in_grams) as force:
        assert cell.line.name in force.title
        until(lambda: force.read(0) == pytest.approx(0.5, abs=0.015))
    with open_cell(url) as raw:
        assert raw.reading() in (50, 51)
        came = raw.collect(0.3)
        assert came.dtype == np.float64
        assert set(came) <= {50, 51}
        seen = set(came)
        until(lambda: seen.update(raw.collect(0.3)) or seen == {50, 51})
        cell.data = lambda number: b""
        mute = {"value": cell.line.name, "allowed": 2}
        with raises(SourceError, **mute):
            [raw.collect(0.05) for _ in range(3)]


def test_unplugged_and_back(make_device, in_grams, tmp_path):
    first = make_device(grams(50))
    name = tmp_path / "port"
    name.symlink_to(first.line.name)
    with open_force(f"hx711:{name}?baud=115200", in_grams) as force:
        assert force.read(0) > 0
        name.unlink()
        first.close()
        until(lambda: math.isnan(force.read(0)))
        second = make_device(grams(100))
        name.symlink_to(second.line.name)
        until(lambda: force.read(0) == pytest.approx(1, abs=0.02))
        (note,) = force.notes
        assert f"HX711 at {name}" in note


@pytest.mark.parametrize(("curve", "reading", "force_n"), [
    ((0.0, 0.01), 50, 0.5),
    ((-1.0, 0.01), 50, 0.0),
    ((1.0, 0.01, 0.001), 20, 1.6),
    ((0.0, 1.0), 101, math.nan),
    ((0.0, 0.0, 0.0, 0.0, 0.0, 1e300), 1e6, math.nan),
    ((0.0, 0.0, 0.0, 0.0, 0.0, -1e300), 1e6, math.nan),
])  # fmt: skip
def test_the_curve(make_device, profile, changed, curve, reading, force_n):
    cell = make_device(lambda number: b"%d\r\n" % reading)
    with open_force(f"hx711:{cell.line.name}", changed(profile, {"force.curve": curve})) as force:
        assert force.read(0) == pytest.approx(force_n, nan_ok=True)
        force.read(0)
        assert len(force.notes) == math.isnan(force_n)
        assert all("force.curve" in note for note in force.notes)


@pytest.mark.parametrize(("url", "value"), [
    *((url, url) for url in ("scale:/dev/x", "hx711:", "hx711:?baud=9600")),
    ("hx711:/dev/x?baud=fast", "fast"), ("hx711:/dev/x?baud=", "?baud="),
    ("loadcell:/dev/nowhere", "/dev/nowhere"),
])  # fmt: skip
def test_what_cannot_be_opened(url, value):
    with raises(SourceError, value=value):
        open_cell(url)


@pytest.mark.parametrize("data", [b"", b"\x81\x92\xf0"])
def test_a_cell_from_which_nothing_comes(make_device, monkeypatch, data):
    monkeypatch.setattr(forces, "FIRST_READING_S", 0.3)
    threads = threading.active_count()
    cell = make_device(lambda number: data)
    with raises(SourceError, value=cell.line.name, allowed=0.3):
        open_cell(f"hx711:{cell.line.name}")
    assert threading.active_count() == threads + 1
