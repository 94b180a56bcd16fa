"""Motions of the hand: by itself, along a recorded way, by a sensor."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import SourceError
from smarttouch.instruments.hand_motion import (
    REST_S,
    START_S,
    SweepMotion,
    open_motion,
    strokes_over,
)

from ..raising import raises


def places(motion, step_s=0.01):
    found, time_s = [], 0.0
    while (place := motion.read(round(1e9 * time_s))) is not None:
        found.append(place)
        time_s += step_s
    return np.array(found)


def test_a_virtual_hand_strokes_back_and_forth():
    way = places(SweepMotion(50.0, (40.0, 0.0)))
    speed = np.hypot(*np.diff(way, axis=0).T) / 0.01
    moving = speed > 1
    assert np.median(speed[moving]) == pytest.approx(50.0)
    assert way[:, 0].max() == pytest.approx(40.0)
    assert way[-1] == pytest.approx([0, 0], abs=1e-6)
    assert not moving[: round(START_S * 100) - 1].any()
    assert len(way) == pytest.approx(100 * (START_S + 1.6 + 2 * REST_S), abs=2)


@given(
    wide=st.floats(1, 200), high=st.floats(1, 100), across=st.floats(2, 30), down=st.floats(2, 30)
)
def test_strokes_pass_every_electrode_over_all_of_a_texture(wide, high, across, down):
    options = strokes_over((wide, high), (across, down))
    left, top = options.pop("origin_mm")
    motion = SweepMotion(1000.0, **options)
    way = motion._table[:, 1:] + (left, top)
    assert (way[:, 0].min() + across / 2, way[:, 0].max() - across / 2) == pytest.approx((0, wide))
    lanes = np.unique(np.round(way[:, 1], 6))
    # The array reaches from edge to edge, a little of a lane's height may be left over.
    left_over = 0.15 * down + 1e-6
    assert lanes[0] - down / 2 <= left_over
    assert lanes[-1] + down / 2 >= high - left_over
    assert (np.diff(lanes) <= down + left_over).all()
    if high <= down:
        assert lanes == pytest.approx([high / 2])


def test_rounds():
    assert open_motion("sweep:3").duration_s > 2.5 * open_motion("sweep:").duration_s


def test_a_recorded_way(tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("force_n, time_s,x_mm,note,y_mm\n0.2,5,10,a,3\n0.6,6,14,b,1\n\n0,8,14,,1\n")
    motion = open_motion(f"path:{path}")
    assert motion.read(500_000_000) == pytest.approx((2, -1))
    assert motion.force_n == pytest.approx(0.4)
    assert motion.origin_mm == (10, 3)
    assert motion.read(3_000_000_001) is None
    assert (motion.knows_force, motion.duration_s) == (True, 3)


def test_a_sensor_gives_the_motion():
    with open_motion("text:abc") as motion:
        assert motion.read(0) == (0, 0)
        assert motion.read(900_000_000)[0] > 0
        assert motion.knows_force
        assert motion.force_n > 0


@pytest.mark.parametrize(("url", "options", "about", "value"), [
    ("wheel:", {}, "motion", "wheel:"),
    ("sweep:x", {}, "rounds", "x"),
    ("sweep:0", {}, "rounds", "0"),
    ("sweep:99999", {}, "rounds", "99999"),
    ("sweep:", {"speed_mm_s": 0.0}, "speed_mm_s", 0.0),
    ("sweep:", {"cpi": 400}, "cpi", "sweep:"),
    ("path:", {}, "file", None),
    ("path:none.csv", {}, "file", Path("none.csv")),
    ("camera:x", {}, "camera", "x"),
])  # fmt: skip
def test_errors_are_reported(url, options, about, value):
    known = ("sweep", "path", "evdev", "camera")
    allowed = {"motion": known, "rounds": (1, 10_000)}.get(about)
    with raises(SourceError, names=about, value=value, allowed=allowed):
        open_motion(url, **options)


def test_too_many_strokes():
    with raises(SourceError, names="strokes", value=lambda strokes: strokes > 10 * 9999):
        open_motion("sweep:9999", span_mm=(10, 1000))


@pytest.mark.parametrize(("text", "about", "value"), [
    ("x_mm,y_mm\n0,0\n", "columns", ("x_mm", "y_mm")),
    ("time_s,x_mm,y_mm\n0,0,0\n", "rows", 1),
    ("time_s,x_mm,y_mm\n0,0,0\n1,1,1\n1,2,2\n3,0,0\n", "line", 4),
])  # fmt: skip
def test_a_wrong_path_is_reported_with_its_line(tmp_path, text, about, value):
    path = tmp_path / "way.csv"
    path.write_text(text)
    with raises(SourceError, names=about, value=value) as caught:
        open_motion(f"path:{path}")
    assert str(path) in str(caught.value)
