"""The picture of what was felt shows current where it was delivered."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.page_image import Page
from smarttouch.running.step import Step, StepResult
from smarttouch.sources.source_contract import Frame, Pose, Sheet
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.views.delivered_drawing import PageDrawing
from smarttouch.views.figure_style import require_drawable

from ..support.checks import raises

AREA = ((0.0, 0.0), (200, 300), 0.1)
"""Of the whole page."""


@pytest.fixture
def drawing(profile, make_bank):
    """An array whose receptors answer only to anodic current of their own electrode."""
    own = -np.eye(64, dtype=np.float32)
    sheet = Sheet(0, Page(np.full((200, 300), 255, np.uint8), 0.1))
    return PageDrawing(profile, make_bank(own, own), (Afferent.RA,), lambda: sheet)


def at(number, x, y, angle=0.0, intensity=1.0):
    frame = Frame(np.zeros((2, 2), np.uint8), number, Pose(x, y, angle), 1.0)
    empty = np.zeros(0, np.uint16)
    sequence = ScanSequence(
        np.zeros((0, 64), np.int16), empty, empty, empty, 20_000, intensity, number
    )
    return StepResult(Step(frame, None, sequence, Mode.RA), number, 1.0)


def slot(electrode, current_ua=-2000):
    current = np.zeros((1, 64), np.int16)
    current[0, electrode] = current_ua
    return current


def deliver(drawing, numbers, currents, width_us=200.0):
    numbers = np.array(numbers, np.uint32)
    drawing.deliver(numbers, np.full(len(numbers), width_us, np.float32), currents)


def darkest(picture):
    rows, columns = np.nonzero(picture == picture.min())
    return columns.mean() * 0.1, rows.mean() * 0.1


@pytest.mark.parametrize(("angle", "side"), [(0.0, -1), (np.pi / 2, 1)])
def test_a_pulse_is_drawn_where_the_electrode_was(drawing, angle, side):
    drawing.watch(at(1, 12.0, 9.0, angle))
    deliver(drawing, [1], slot(0))
    expected = pytest.approx((12.0 + side * 7 / 3.2, 9.0 - 7 / 3.2), abs=0.11)
    assert darkest(drawing.picture(*AREA)) == expected


@pytest.mark.parametrize(("current_ua", "x_mm", "number"), [
    (2000, 12.0, 1),  # cathodic: RA does not answer
    (-1200, 12.0, 1),  # below threshold
    (-2000, -50.0, 1),  # off the page
    (-2000, 12.0, 2),  # of another sequence
])  # fmt: skip
def test_what_is_not_felt_there_is_not_drawn(drawing, current_ua, x_mm, number):
    drawing.watch(at(1, x_mm, 9.0))
    deliver(drawing, [number], slot(0, current_ua))
    assert drawing.picture(*AREA).min() == 255


def test_a_full_pulse_is_black_and_a_weaker_one_grey(drawing):
    drawing.watch(at(1, 8.0, 9.0))
    drawing.watch(at(2, 20.0, 9.0))
    currents = np.vstack([slot(0, -2400), slot(0, -1800)])
    deliver(drawing, [1, 2], currents)
    picture = drawing.picture(*AREA)
    assert picture.min() == 0
    assert abs(int(picture[:, 150:].min()) - 128) <= 2


def test_a_shorter_pulse_does_less_than_a_long_one_and_more_than_its_charge(drawing):
    drawing.watch(at(1, 12.0, 9.0))
    # Weiss, chronaxie 200 µs: at 100 µs a current does 2/3 of what it does at 200 µs.
    deliver(drawing, [1], slot(0, -2400), 100.0)
    assert drawing.picture(*AREA).min() == pytest.approx(255 * (1 - 1 / 3), abs=2)


def test_a_sequence_that_was_lost_with_the_board_is_not_drawn(drawing):
    drawing.watch(at(1, 12.0, 9.0))
    for _ in range(3):
        drawing.watch(replace(at(1, 12.0, 9.0), number=None))
    deliver(drawing, [1], slot(0, -2400))
    # Nor does it make what was felt there paler.
    assert drawing.picture(*AREA).min() == 0


def test_where_nothing_was_seen_the_touch_is_drawn_alone(profile, make_bank, tmp_path):
    own = -np.eye(64, dtype=np.float32)
    drawing = PageDrawing(profile, make_bank(own, own), (Afferent.RA,))
    drawing.watch(at(1, 12.0, 9.0))
    deliver(drawing, [1], slot(0, -2400))
    assert drawing.picture(*AREA).min() == 0
    drawing.save(tmp_path / "felt.png")
    with Image.open(tmp_path / "felt.png") as sheet:
        assert sheet.height / sheet.width < 1.3


def test_lines_that_were_read_are_drawn_one_below_the_other(profile, make_bank):
    own, line = -np.eye(64, dtype=np.float32), np.full((40, 100), 255, np.uint8)
    line[:, 50:] = 0
    sheets = iter([Sheet(0, Page(line, 0.1), (0.0, -2.0)), Sheet(1, Page(line, 0.1), (0.0, 8.0))])
    drawing = PageDrawing(profile, make_bank(own, own), (Afferent.RA,), lambda: next(sheets))
    for number, y_mm in enumerate((0.0, 10.0)):
        drawing.watch(at(number, 5.0, y_mm))
    _, corner_mm, size_mm, draw = drawing.under()
    assert (corner_mm, size_mm) == ((0.0, -2.0), (10.0, 14.0))
    drawn = draw((70, 50), 0.2)
    assert [drawn[row, 40] for row in (10, 35, 60)] == [0, 255, 0]
    assert drawn[:, :20].min() == 255


def test_save(drawing, tmp_path):
    drawing.watch(at(1, 12.0, 9.0))
    deliver(drawing, [], np.empty((0, 64), np.int16))
    drawing.save(tmp_path / "felt.png")
    with Image.open(tmp_path / "felt.png") as sheet:
        assert sheet.width > 700
        # A black bar of whole millimeters beside the first label, by the resolution that it says.
        above = np.asarray(sheet)[:52, :-24] == 40
        runs = [run for row in above for run in "".join(np.where(row, "#", " ")).split()]
        bar_px = max(map(len, runs))
        bar = bar_px / sheet.info["dpi"][0] * 25.4
        assert bar == pytest.approx(round(bar), abs=0.2)
        assert bar >= 1
    path = tmp_path / "none" / "felt.png"
    with raises(SmartTouchError, names="file", value=path):
        drawing.save(path)


def test_without_matplotlib_a_figure_is_refused_before_any_work(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with raises(SmartTouchError, names="pip install 'smarttouch[plot]'"):
        require_drawable(Path("figure.svg"))
