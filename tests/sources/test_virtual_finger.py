"""Tests of the virtual finger: its images of a page, its path and its force."""

import itertools
import math

import cv2
import numpy as np
import pytest
from PIL import Image

from smarttouch.base.errors import SourceError
from smarttouch.base.files import data_folder
from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import find_lines, print_text
from smarttouch.sources import open_source
from smarttouch.sources.source_contract import Pose
from smarttouch.sources.virtual_finger import (
    AGAIN_S,
    PageSource,
    open_page,
    reading_path,
    recorded_path,
)

from ..pages.printed import print_page
from ..support.checks import numbers_in, raises

TEN_MS = 10_000_000
HEADER = "time_s,x_mm,y_mm,angle_deg,force_n\n"


def at(path, time_s):
    """Return the pose and the force of a path at ``time_s``."""
    *pose, force_n = (np.interp(time_s, path.table[0], row) for row in path.table[1:])
    return Pose(*pose), force_n


@pytest.fixture
def still(tmp_path, profile):
    """Return a function that makes a source whose finger rests at (10, 10) mm on a page."""

    def make(grey, mm_per_pixel, angle=0.0):
        path = tmp_path / "path.csv"
        path.write_text(f"{HEADER}0,10,10,{angle},1\n9,10,10,{angle},1\n")
        return PageSource(Page(grey, mm_per_pixel), profile, "still", path=path)

    return make


def spot(x_mm, y_mm, side_mm=0.8, mm_per_pixel=0.04):
    """Return a white page of 20 x 20 mm with a black square at (x, y)."""
    grey = np.full((500, 500), 255, np.uint8)
    rows, columns = (
        slice(round((v - side_mm / 2) / mm_per_pixel), round((v + side_mm / 2) / mm_per_pixel))
        for v in (y_mm, x_mm)
    )
    grey[rows, columns] = 0
    return grey


@pytest.mark.parametrize(("y_mm", "angle", "x", "y"), [(9.5, 0, 44.8, 25.6), (10, 90, 32, 19.2)])
def test_a_spot_is_where_it_lies_and_turns_against_the_finger(still, y_mm, angle, x, y):
    frame = still(spot(11.0, y_mm), 0.04, angle).read(0)
    rows, columns = np.nonzero(frame.image < 128)
    assert columns.mean() + 0.5 == pytest.approx(x, abs=0.5)
    assert rows.mean() + 0.5 == pytest.approx(y, abs=0.5)
    assert frame.force_n == 1


def opened(profile, seed, name="page.png"):
    return open_source(f"page:{data_folder('sample_images') / name}", profile, seed=seed)


def test_same_seed_same_frames_in_any_order(profile):
    one, two = opened(profile, 3), opened(profile, 3)
    times = [k * TEN_MS for k in range(60, 120, 7)]
    forward = {time: one.read(time) for time in times}
    backward = {time: two.read(time) for time in reversed(times)}
    for time in times:
        assert np.array_equal(forward[time].image, backward[time].image)
        assert forward[time].force_n == backward[time].force_n


def test_light_print_is_shown_dark_unless_imaging_knows_of_it(profile, tmp_path):
    page = print_text("touch")

    def show(grey, **options):
        Image.fromarray(grey).save(tmp_path / "page.png")
        dpi = 25.4 / page.mm_per_pixel
        return open_page(str(tmp_path / "page.png"), profile, dpi=dpi, **options)

    dark, light = show(page.grey), show(255 - page.grey)
    np.testing.assert_array_equal(light.read(TEN_MS).image, dark.read(TEN_MS).image)
    assert dark.notes == []
    assert "light on dark" in light.notes[0]
    asked = show(255 - page.grey, light_on_dark=True)
    np.testing.assert_array_equal(asked.page.grey, 255 - dark.page.grey)


@pytest.mark.parametrize("stated", [{}, {"dpi": (1200, 1200)}])
def test_a_page_of_unknown_size_has_print_of_a_usual_one(tmp_path, profile, stated):
    line = print_page(["a word or two"], size_pt=11, dpi=150).page.grey
    Image.fromarray(line).save(tmp_path / "line.png", **stated)
    source = open_page(str(tmp_path / "line.png"), profile)
    wide_mm = line.shape[1] * 25.4 / 150
    assert source.page.size_mm[0] == pytest.approx(wide_mm, rel=0.2)
    assert numbers_in(source.notes[0])[-1] == pytest.approx(wide_mm, rel=0.2)


def test_a_page_is_read_again_and_again(profile):
    once, twice, forever = (
        open_source("text:i", profile, speed_mm_s=100, passes=passes) for passes in (1, 2, 0)
    )
    round_ns = round((once.duration_s + AGAIN_S) * 1e9)
    assert (twice.duration_s, forever.duration_s) == (2 * once.duration_s + AGAIN_S, None)
    for time_ns in (100_000_000, 640_000_000):
        first, later = once.read(time_ns), forever.read(time_ns + 7 * round_ns)
        assert (later.pose.x_mm, later.force_n) == pytest.approx(
            (first.pose.x_mm, first.force_n), abs=1e-5
        )
    assert forever.read(round_ns - 500_000_000).force_n == 0
    assert once.read(round_ns) is twice.read(2 * round_ns) is None
    assert twice.read(round_ns - 1000).force_n == 0


def test_a_blank_page_is_read_in_strips(profile):
    path = reading_path(Page(np.full((300, 400), 255, np.uint8), 0.1), profile, 40)
    assert len(path.lines) == 6
    assert path.lines[-1].bottom_mm == pytest.approx(30)


@pytest.mark.parametrize("word", ["i", "Hi", "to", "L"])
def test_a_word_too_short_for_a_line_is_read_where_it_is(profile, word):
    page = print_text(word)
    rows, columns = np.nonzero(page.grey < 128)
    path = reading_path(page, profile, 40)
    (line,) = path.lines
    assert line.left_mm <= columns.min() * page.mm_per_pixel
    assert line.right_mm >= columns.max() * page.mm_per_pixel
    # The line includes space for descenders below the word.
    assert -0.5 < line.bottom_mm - rows.max() * page.mm_per_pixel < 1.5
    assert path.duration_s < 2


def test_the_finger_lands_settles_sweeps_and_lifts(profile):
    path = reading_path(print_text("one line\nand another"), profile, 40)
    times = np.arange(0, path.duration_s, 0.01)
    poses, forces = zip(*(at(path, time) for time in times), strict=True)
    x = np.array([pose.x_mm for pose in poses])
    pressing = np.array(forces) > profile.force.full_n * 0.9
    starts = np.flatnonzero(np.diff(pressing.astype(int)) == 1)
    assert len(starts) == 2
    assert forces[0] == 0
    assert at(path, path.duration_s)[1] == pytest.approx(0)
    assert np.diff(x[pressing]).min() >= -60
    sweeping = np.diff(x) / 0.01
    assert np.median(sweeping[sweeping > 1]) == pytest.approx(40, rel=0.01)
    # The finger rests on the first letters until their pulses have raised the ramp.
    assert at(path, 0)[0].x_mm == at(path, 0.7)[0].x_mm == path.lines[0].left_mm
    # Points of the path are at most 2.2 mm apart, to follow curved lines.
    assert np.diff(path.table[1]).max() <= 2.2


@pytest.mark.parametrize("skew_deg", [-3, 3])
def test_a_tilted_line_is_followed_by_hand_and_patch(profile, skew_deg):
    page = print_text("many fingers read on\nand on they read")
    middle = tuple(side / 2 for side in page.grey.shape[::-1])
    turn = cv2.getRotationMatrix2D(middle, -skew_deg, 1)
    grey = cv2.warpAffine(page.grey, turn, page.grey.shape[::-1], borderValue=255)
    path = reading_path(Page(grey, page.mm_per_pixel), profile, 40)
    line = path.lines[0]
    for time in np.arange(0.8, 2.0, 0.1):
        pose, _ = at(path, time)
        base_mm = float(line.baseline_mm(np.array(pose.x_mm)))
        assert pose.y_mm == pytest.approx(
            base_mm + (line.descent_mm - line.ascent_mm) / 2, abs=0.01
        )
        assert pose.angle_rad == pytest.approx(math.radians(skew_deg), abs=math.radians(0.3))
    begin, end = at(path, 0.8)[0], at(path, 1.8)[0]
    way_mm = math.hypot(end.x_mm - begin.x_mm, end.y_mm - begin.y_mm)
    assert way_mm == pytest.approx(40, rel=0.01)


def test_a_tall_line_takes_several_sweeps(profile):
    small = print_text("on they read")
    path = reading_path(Page(small.grey, 3 * small.mm_per_pixel), profile, 40)
    line = find_lines(Page(small.grey, 3 * small.mm_per_pixel))[0]
    assert len(path.lines) == 3
    assert path.lines[0].top_mm == pytest.approx(line.top_mm)
    assert path.lines[-1].bottom_mm == pytest.approx(line.bottom_mm)
    assert all(a.bottom_mm == pytest.approx(b.top_mm) for a, b in itertools.pairwise(path.lines))


@pytest.mark.parametrize(("option", "value"), [
    *(("speed_mm_s", each) for each in (0, -1, 501, math.nan, math.inf)),
    ("passes", -1), ("passes", 10_001),
])  # fmt: skip
def test_impossible_options(profile, option, value):
    with raises(SourceError, names=option, value=value):
        open_source("text:x", profile, **{option: value})


def test_recorded_path(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text(HEADER + "10,0,0,0,0\n11,10,4,90,1\n")
    path = recorded_path(file)
    pose, force = at(path, 0.5)
    assert (pose.x_mm, pose.y_mm, force) == (5, 2, 0.5)
    assert pose.angle_rad == pytest.approx(math.pi / 4)
    assert path.duration_s == 1
    file.write_text("a,b\n")
    with raises(SourceError, names="path.csv", value=("a", "b")):
        recorded_path(file)
