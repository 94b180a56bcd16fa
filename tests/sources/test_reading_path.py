"""The finger reads line by line, or as it was recorded."""

import itertools
import math

import cv2
import numpy as np
import pytest

from smarttouch.base.errors import SourceError
from smarttouch.pages.page_image import Page
from smarttouch.pages.prepared_page import print_text
from smarttouch.pages.text_lines import find_lines
from smarttouch.sources.virtual_finger import ReadingPath, RecordedPath

from ..raising import raises

HEADER = "time_s,x_mm,y_mm,angle_deg,force_n\n"


@pytest.mark.parametrize("count", [1, 2, 5])
def test_printed_lines_are_all_found(count):
    page = print_text("\n".join(["finger tips"] * count))
    lines = find_lines(page)
    assert len(lines) == count
    # Ascender to descender, of letters of 5.3 mm.
    assert all(5.0 < line.bottom_mm - line.top_mm < 5.5 for line in lines)
    for line in lines:
        top, bottom = (round(edge / page.mm_per_pixel) for edge in (line.top_mm, line.bottom_mm))
        rows = np.flatnonzero((page.grey[top:bottom] < 128).any(axis=1))
        assert 2.5 < (rows[-1] - rows[0] + 1) * page.mm_per_pixel < 5.2


def test_a_blank_page_is_read_in_strips(profile):
    path = ReadingPath(Page(np.full((300, 400), 255, np.uint8), 0.1), profile, 40)
    assert len(path.lines) == 6
    assert path.lines[-1].bottom_mm == pytest.approx(30)


@pytest.mark.parametrize("word", ["i", "Hi", "to", "L"])
def test_a_word_too_short_for_a_line_is_read_where_it_is(profile, word):
    page = print_text(word)
    rows, columns = np.nonzero(page.grey < 128)
    path = ReadingPath(page, profile, 40)
    (line,) = path.lines
    assert line.left_mm <= columns.min() * page.mm_per_pixel
    assert line.right_mm >= columns.max() * page.mm_per_pixel
    # Below it is place for a descender.
    assert -0.5 < line.bottom_mm - rows.max() * page.mm_per_pixel < 1.5
    assert path.duration_s < 2


def test_the_finger_lands_settles_sweeps_and_lifts(profile):
    path = ReadingPath(print_text("one line\nand another"), profile, 40)
    times = np.arange(0, path.duration_s, 0.01)
    poses, forces = zip(*(path.at(time) for time in times), strict=True)
    x = np.array([pose.x_mm for pose in poses])
    pressing = np.array(forces) > profile.force.full_n * 0.9
    starts = np.flatnonzero(np.diff(pressing.astype(int)) == 1)
    assert len(starts) == 2
    assert forces[0] == 0
    assert path.at(path.duration_s)[1] == pytest.approx(0)
    assert np.diff(x[pressing]).min() >= -60
    sweeping = np.diff(x) / 0.01
    assert np.median(sweeping[sweeping > 1]) == pytest.approx(40, rel=0.01)
    # It rests with the first letters under it, whose pulses let intensity rise.
    assert path.at(0)[0].x_mm == path.at(0.7)[0].x_mm == path.lines[0].left_mm


@pytest.mark.parametrize("speed", [2, 40, 400])
def test_the_finger_presses_until_just_before_the_end(profile, speed):
    path = ReadingPath(print_text("on"), profile, speed)
    full_n = profile.force.full_n
    assert path.at(path.duration_s - 0.06)[1] > full_n
    assert path.at(path.duration_s - 0.01)[1] < 0.5 * full_n


@pytest.mark.parametrize("skew_deg", [-3, 3])
def test_a_tilted_line_is_followed_by_hand_and_patch(profile, skew_deg):
    page = print_text("many fingers read on\nand on they read")
    middle = tuple(side / 2 for side in page.grey.shape[::-1])
    turn = cv2.getRotationMatrix2D(middle, -skew_deg, 1)
    grey = cv2.warpAffine(page.grey, turn, page.grey.shape[::-1], borderValue=255)
    path = ReadingPath(Page(grey, page.mm_per_pixel), profile, 40)
    line = path.lines[0]
    for time in np.arange(0.8, 2.0, 0.1):
        pose, _ = path.at(time)
        base_mm = float(line.baseline_mm(np.array(pose.x_mm)))
        assert pose.y_mm == pytest.approx(
            base_mm + (line.descent_mm - line.ascent_mm) / 2, abs=0.01
        )
        assert pose.angle_rad == pytest.approx(math.radians(skew_deg), abs=math.radians(0.3))
    begin, end = path.at(0.8)[0], path.at(1.8)[0]
    way_mm = math.hypot(end.x_mm - begin.x_mm, end.y_mm - begin.y_mm)
    assert way_mm == pytest.approx(40, rel=0.01)


def test_a_tall_line_takes_several_sweeps(profile):
    small = print_text("on they read")
    path = ReadingPath(Page(small.grey, 3 * small.mm_per_pixel), profile, 40)
    line = find_lines(Page(small.grey, 3 * small.mm_per_pixel))[0]
    assert len(path.lines) == 3
    assert path.lines[0].top_mm == pytest.approx(line.top_mm)
    assert path.lines[-1].bottom_mm == pytest.approx(line.bottom_mm)
    assert all(a.bottom_mm == pytest.approx(b.top_mm) for a, b in itertools.pairwise(path.lines))


@pytest.mark.parametrize("speed", [0, -1, 501, math.nan, math.inf])
def test_impossible_speeds(profile, speed):
    with raises(SourceError, names="speed_mm_s", value=speed):
        ReadingPath(print_text("x"), profile, speed)


def test_recorded_path(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(HEADER + "10,0,0,0,0\n11,10,4,90,1\n")
    path = RecordedPath(file)
    pose, force = path.at(0.5)
    assert (pose.x_mm, pose.y_mm, force) == (5, 2, 0.5)
    assert pose.angle_rad == pytest.approx(math.pi / 4)
    assert path.duration_s == 1


@pytest.mark.parametrize(("text", "about", "value"), [
    (None, "file", "path.csv"),
    ("a,b\n", "columns", ("a", "b")),
    (HEADER + "0,0,0,0,0\n", "rows", 1),
    (HEADER + "0,0,0,0,0\n0,0,0,0,0\n", "line", 3),
])  # fmt: skip
def test_bad_recorded_paths(tmp_path, text, about, value):
    file = tmp_path / "path.csv"
    if text is not None:
        file.write_text(text)
    with raises(SourceError, value=value) as caught:
        RecordedPath(file)
    assert str(file) in str(caught.value)
