"""Tests of pictures that show delivered current and spikes at their places on the page."""

import numpy as np
import pytest
from PIL import Image

import smarttouch as st
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.page_and_lines import Page
from smarttouch.physiology.spikes import DeliveredSlots, SpikeModel, delivered_spikes
from smarttouch.running.step_records import Step, StepResult
from smarttouch.sources.source_contract import Frame, Pose, Sheet
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.views.delivered_drawing import PageDrawing, SpikeMap

from ..support.checks import raises

AREA = ((0.0, 0.0), (200, 300), 0.1)
"""The whole page: corner (mm), height and width (pixels), and mm per pixel."""


@pytest.fixture
def drawing(profile, make_bank):
    """Return a drawing. Each receptor responds only to anodic current of its own electrode."""
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
    (2000, 12.0, 1),  # cathodic: RA does not respond
    (-1200, 12.0, 1),  # below threshold
    (-2000, -50.0, 1),  # off the page
    (-2000, 12.0, 2),  # the pulse belongs to another sequence
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


def test_save(drawing, tmp_path):
    drawing.watch(at(1, 12.0, 9.0))
    deliver(drawing, [], np.empty((0, 64), np.int16))
    drawing.save(tmp_path / "felt.png")
    with Image.open(tmp_path / "felt.png") as sheet:
        assert sheet.width > 700
    path = tmp_path / "none" / "felt.png"
    with raises(SmartTouchError, names="file", value=path):
        drawing.save(path)


RA, SAI, PC = st.Afferent
SITE = 27


@pytest.fixture(scope="module")
def finger(profile):
    return st.Finger(profile, seed=1, anatomy="paper")


@pytest.fixture(scope="module")
def pulse(profile, bank):
    current = 1000 * profile.full_ma[SITE] * bank.kernels(SAI)[SITE]
    return np.rint(current).astype(np.int16)


def test_spikes_are_those_of_each_sequence(finger, pulse):
    numbers = np.array([3, 3, 4, 6], np.uint32)
    current = np.stack([pulse, pulse, 0 * pulse, pulse])
    width = np.full(4, 200, np.float32)
    found = delivered_spikes(finger, numbers, width, current, {3: 20_000, 4: 20_000, 5: 20_000})
    assert list(found) == [3, 4]
    assert found[4].sum() == 0
    # The second slot falls into the refractory time, so a fiber fires at most once.
    assert set(found[3]) == {0, 1}
    alone = DeliveredSlots(pulse[None], np.array([200]), np.array([100]), 20_000)
    fired = SpikeModel(finger).fire(alone).counts
    assert np.count_nonzero(found[3] != fired) <= 1


@pytest.mark.parametrize(("afferent", "own", "other"), [(RA, 0, 2), (SAI, 2, 0)])
def test_a_class_is_drawn_in_its_color_where_its_receptors_were(finger, afferent, own, other):
    distance = np.where(finger.classes == afferent, np.abs(finger.receptor_mm).sum(axis=1), 99)
    counts = np.zeros(len(finger.classes), np.intp)
    counts[distance.argmin()] = 3
    drawn = SpikeMap(
        finger, lambda places, pose: places + np.array([12 + pose.x_mm, 12]), (240, 480), 0.1
    )
    # Several passes with the same spikes must look like a single pass.
    for x_mm in (0.0, 22.0, 22.0, 22.0):
        drawn.add(Pose(x_mm, 0.0), counts)
    image, again = np.split(drawn.image(), 2, axis=1)
    assert again.min() == image.min()
    row, column = np.unravel_index(image.sum(axis=2).argmin(), image.shape[:2])
    place = np.array([column, row]) * 0.1 - 12
    assert np.abs(place - finger.receptor_mm[distance.argmin()]).max() < 0.15
    # RA is orange, with more red than blue. SAI is blue, with more blue than red.
    assert image[row, column, own] > image[row, column, other]
    assert image.max() == 255


@pytest.mark.parametrize("spikes", [False, True])
def test_the_picture_has_a_panel_in_color(drawing, finger, pulse, tmp_path, spikes):
    drawing.watch(at(1, 12.0, 9.0))
    drawing.deliver(np.ones(1, np.uint32), np.full(1, 200, np.float32), pulse[None],
                    finger if spikes else None)  # fmt: skip
    drawing.save(tmp_path / "felt.png")
    with Image.open(tmp_path / "felt.png") as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    colored = np.flatnonzero(np.ptp(pixels, axis=2).max(axis=1) > 60)
    assert (len(colored) > 0) == spikes
    assert not spikes or colored.min() > len(pixels) / 2
