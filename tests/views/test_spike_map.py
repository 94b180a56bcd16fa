"""Spikes under delivered pulses are drawn where receptors were, by class."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import smarttouch as st
from smarttouch.pages.page_image import Page
from smarttouch.physiology.spikes import DeliveredSlots, SpikeModel, delivered_spikes
from smarttouch.sources.source_contract import Pose, Sheet
from smarttouch.views.delivered_drawing import PageDrawing, SpikeMap

from .test_delivered_drawing import at

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
    # A slot later is within the refractory time: one spike each.
    assert set(found[3]) == {0, 1}
    alone = DeliveredSlots(pulse[None], np.array([200]), np.array([100]), 20_000)
    fired = SpikeModel(finger).fire(alone).counts
    assert np.count_nonzero(found[3] != fired) <= 1


def test_of_too_many_slots_sequences_are_left_out_evenly(finger, pulse):
    numbers = np.arange(1, 13, dtype=np.uint32)
    current, width = np.tile(pulse, (12, 1)), np.full(12, 200, np.float32)
    periods = dict.fromkeys(range(1, 13), 20_000)
    found = delivered_spikes(finger, numbers, width, current, periods, most_slots=5)
    assert list(found) == [1, 4, 7, 10]


def test_a_class_is_drawn_in_its_color_where_its_receptors_were(finger):
    counts = np.zeros(len(finger.classes), np.intp)
    middle = [
        int(np.where(finger.classes == each, np.abs(finger.receptor_mm).sum(axis=1), 99).argmin())
        for each in (RA, SAI)
    ]
    for which, own, other in ((middle[0], 0, 2), (middle[1], 2, 0)):
        alone = counts.copy()
        alone[which] = 3
        drawn = SpikeMap(finger, lambda places, _: places + 12, (240, 240), 0.1)
        drawn.add(Pose(0.0, 0.0), alone)
        image = drawn.image()
        row, column = np.unravel_index(image.sum(axis=2).argmin(), image.shape[:2])
        place = np.array([column, row]) * 0.1 - 12
        assert np.abs(place - finger.receptor_mm[which]).max() < 0.15
        # Orange has more red than blue; blue the other way round.
        assert image[row, column, own] > image[row, column, other]
        assert image.max() == 255


def test_where_the_finger_passed_often_nothing_is_darker(finger, pulse):
    fired = SpikeModel(finger).fire(
        DeliveredSlots(pulse[None], np.array([200]), np.array([100]), 20_000)
    ).counts  # fmt: skip
    once, often = (
        SpikeMap(finger, lambda places, _: places + 12, (120, 120), 0.2) for _ in range(2)
    )
    for drawn, times in ((once, 1), (often, 7)):
        for _ in range(times):
            drawn.add(Pose(0, 0), fired)
    once, often = once.image(), often.image()
    assert np.abs(once.astype(int) - often.astype(int)).max() <= 1


def test_the_picture_has_a_panel_in_color(profile, bank, finger, pulse, tmp_path):
    sizes = {}
    for name, given in (("with", finger), ("without", None)):
        page = Page(np.full((200, 300), 255, np.uint8), 0.1)
        drawing = PageDrawing(profile, bank, (SAI,), lambda page=page: Sheet(0, page))
        drawing.watch(at(1, 12.0, 9.0))
        drawing.watch(replace(at(2, 13.0, 9.0)))
        numbers, width = np.array([1, 2], np.uint32), np.full(2, 200, np.float32)
        drawing.deliver(numbers, width, np.stack([pulse, pulse]), given)
        drawing.save(tmp_path / f"{name}.png")
        with Image.open(tmp_path / f"{name}.png") as sheet:
            sizes[name] = sheet.size
            pixels = np.asarray(sheet.convert("RGB")).astype(int)
        apart = np.ptp(pixels, axis=2).max(axis=1)
        if given is None:
            assert apart.max() == 0
        else:
            colored = np.flatnonzero(apart > 60)
            assert colored.min() > sheet.height / 2
    assert sizes["with"][0] == sizes["without"][0]
    assert sizes["with"][1] == pytest.approx(1.5 * sizes["without"][1], rel=0.05)
