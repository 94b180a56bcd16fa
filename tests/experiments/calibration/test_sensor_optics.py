"""Measured optics of a sensor are the true ones."""

import numpy as np
import pytest

from smarttouch.base.errors import CalibrationError
from smarttouch.experiments.sensor_optics import (
    MOST_UNEVEN,
    collect_images,
    measure_optics,
    uncorrected,
)
from smarttouch.sources.source_contract import Frame, OpticalSource, Pose

from ...raising import raises
from .simulated_sensors import SimulatedPatch


def found(patch, frames=16):
    return measure_optics(patch.images(frames, light=False), patch.images(frames, light=True))


def test_a_known_patch():
    patch = SimulatedPatch((64, 64), noise_levels=3.0, dead=5, hot=2, seed=1)
    result = found(patch)
    assert (result.dead, result.hot, result.frames) == (5, 2, (16, 16))
    assert result.noise_levels == pytest.approx(3.0, abs=0.15)
    assert result.dark_level == pytest.approx(14, abs=1)
    assert result.uneven_before > 0.08
    assert result.uneven_after < 0.012
    assert all(each in result.sentence() for each in ("64 × 64", "5 dead", "2 hot"))


def test_after_is_judged_on_frames_that_the_correction_was_not_made_from():
    """With two frames of each, the correction of one frame only evens itself out."""
    result = found(SimulatedPatch(noise_levels=5.0), frames=2)
    assert result.uneven_after > 0.03


def test_one_frame_of_each_gives_no_noise():
    result = found(SimulatedPatch(), frames=1)
    assert np.isnan(result.noise_levels)
    assert result.field.gain.shape == (64, 64)


def test_paper_that_moved_is_refused():
    patch = SimulatedPatch()
    scene = np.ones((64, 64))
    scene[:, ::2] = 0.8
    white = patch.see(scene, 8) + patch.see(scene[:, ::-1], 8)
    alternating = [each for pair in zip(white[:8], white[8:], strict=True) for each in pair]
    moved = {"value": lambda uneven: uneven > MOST_UNEVEN, "allowed": MOST_UNEVEN}
    with raises(CalibrationError, **moved):
        measure_optics(patch.images(16, light=False), alternating)


class Listed(OpticalSource):
    """Each image twice, the third one stale, and then the end."""

    def __init__(self, images, end=True):
        super().__init__("a list")
        self._looks = [(i // 2, image) for i, image in enumerate(np.repeat(images, 2, axis=0))]
        self._end = end

    def read(self, time_ns):
        if not self._looks and self._end:
            return None
        number, image = self._looks.pop(0) if self._looks else (0, np.zeros((2, 2), np.uint8))
        return Frame(image, time_ns, Pose(0, 0), np.nan, number=number, stale=number == 2)


def images(count):
    return [np.full((2, 2), i, np.uint8) for i in range(count)]


def test_each_image_once_and_none_that_is_stale():
    assert [int(each[0, 0]) for each in collect_images(Listed(images(5)), 9)] == [0, 1, 3, 4]
    assert len(collect_images(Listed(images(5)), 2)) == 2


def test_a_sensor_that_gives_nothing(monkeypatch):
    with raises(CalibrationError, names="frames", value="no frames"):
        collect_images(Listed(np.empty((0, 2, 2), np.uint8)), 3)
    monkeypatch.setattr("smarttouch.experiments.sensor_optics.SILENCE_S", 0.05)
    with raises(CalibrationError, names="frames", value=2, allowed=3):
        collect_images(Listed(images(2), end=False), 3)


def test_the_sensor_to_be_calibrated_is_seen_without_its_flat_field(profile, changed):
    named = changed(profile, {"optics.flat_field": "gone.npz"})
    assert uncorrected(named).optics.flat_field is None
