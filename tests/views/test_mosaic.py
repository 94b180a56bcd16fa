"""Frames of a moving sensor are put together to the page."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.prepared_page import print_text
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.sources.virtual_finger import PageSource
from smarttouch.views.delivered_drawing import Mosaic

from ..raising import raises


class Still:
    """A finger that is where a test puts it."""

    duration_s = 9.0

    def at(self, _time_s):
        return self.pose, 1.0


def passed_over(profile, poses, page):
    sensor, mosaic = PageSource(page, profile, "a page"), Mosaic(profile.optics)
    sensor.path = Still()
    for number, pose in enumerate(poses):
        sensor.path.pose = pose
        mosaic.add(replace(sensor.read(number), number=number))
    return mosaic


@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_a_line_that_was_read_is_there_again(profile, angle):
    page = print_text("touch")
    poses = [Pose(x, page.size_mm[1] / 2, angle) for x in np.arange(3, page.size_mm[0] - 3, 0.7)]
    seen, (x_mm, y_mm) = passed_over(profile, poses, page).page()
    columns = (np.arange(seen.grey.shape[1]) + 0.5) * 0.1 + x_mm
    rows = (np.arange(seen.grey.shape[0]) + 0.5) * 0.1 + y_mm
    inside = np.abs(rows - page.size_mm[1] / 2) < 1.5
    across = (columns > 4) & (columns < page.size_mm[0] - 4)
    true = page.grey[
        np.ix_(
            (rows[inside] / page.mm_per_pixel).astype(int),
            (columns[across] / page.mm_per_pixel).astype(int),
        )
    ]
    found = seen.grey[np.ix_(inside, across)]
    assert np.corrcoef(true.ravel(), found.ravel())[0, 1] > 0.9


def test_a_turned_sensor_is_turned_back_by_its_registration(profile):
    """A spot in the image is where an electrode would see it."""
    optics = profile.optics.model_copy(update={"rotation_deg": 30.0})
    image = np.full((64, 64), 255, np.uint8)
    column, row = 48, 24
    image[row - 1 : row + 2, column - 1 : column + 2] = 0
    mosaic = Mosaic(optics)
    mosaic.add(Frame(image, 0, Pose(20.0, 10.0), 1.0))
    page, (left_mm, top_mm) = mosaic.page()
    rows, columns = np.nonzero(page.grey < 100)
    x_mm, y_mm = (np.mean(each) * 0.1 + 0.05 for each in (columns, rows))
    x_mm, y_mm = x_mm + left_mm - 20.0, y_mm + top_mm - 10.0
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    pixel_mm = 5 / 64
    seen_at = ((x_mm * cos - y_mm * sin) / pixel_mm, (x_mm * sin + y_mm * cos) / pixel_mm)
    assert seen_at == pytest.approx((column + 0.5 - 32, row + 0.5 - 32), abs=0.8)


def test_the_same_and_stale_frames_are_left_out(profile):
    mosaic = Mosaic(profile.optics)
    frame = Frame(np.full((64, 64), 100, np.uint8), 0, Pose(0, 0), 1.0)
    mosaic.add(frame)
    mosaic.add(replace(frame, image=np.zeros((64, 64), np.uint8)))
    mosaic.add(replace(frame, image=np.zeros((64, 64), np.uint8), number=1, stale=True))
    page, corner_mm = mosaic.page()
    assert page.grey[10:40, 10:40].min() == 100
    assert corner_mm == pytest.approx((-2.5, -2.5), abs=0.11)


def test_what_is_far_away_does_not_eat_the_memory(profile):
    mosaic = Mosaic(profile.optics)
    frame = Frame(np.full((64, 64), 100, np.uint8), 0, Pose(0, 0), 1.0)
    mosaic.add(frame)
    mosaic.add(replace(frame, number=1, pose=Pose(1e6, -1e6)))
    assert mosaic.page()[0].size_mm == pytest.approx((5, 5), abs=0.2)


def test_nothing_seen_is_no_page(profile):
    with raises(SmartTouchError, names="page"):
        Mosaic(profile.optics).page()
