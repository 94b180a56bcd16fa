"""Patterns of the electrodes, for eyes and for other programs."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.running.step import Step, StepResult
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.views.pattern_files import PatternFile

from ..raising import raises


def step(electrode, intensity=1.0, period_us=20_000):
    activation = np.zeros((3, 64), np.float32)
    activation[Afferent.RA, electrode] = 0.5
    empty = np.zeros(0, np.uint16)
    sequence = ScanSequence(
        np.zeros((0, 64), np.int16), empty, empty, empty, period_us, intensity, 0
    )
    frame = Frame(np.zeros((2, 2), np.uint8), 0, Pose(0, 0), 1.0)
    return StepResult(Step(frame, TactileImage(activation, 0, 1.0), sequence, Mode.RA), 1, 1.0)


@pytest.fixture
def keep(profile, tmp_path):
    """Return a maker of files with three steps: two electrodes, and nothing."""

    def make(name):
        patterns = PatternFile(tmp_path / name, profile)
        for each in (step(0), step(9, period_us=60_000), step(9, intensity=0.0)):
            patterns.watch(each)
        patterns.save()
        return tmp_path / name

    return make


def test_numbers(keep, profile):
    document = json.loads(keep("a.json").read_text())
    assert document["profile"] == profile.name
    assert document["electrodes"][9] == {"x_mm": -5.0, "y_mm": -5.0}
    steps = document["steps"]
    assert [each["time_ms"] for each in steps] == [0, 20, 80]
    active = [np.flatnonzero(each["activation"]).tolist() for each in steps]
    assert active == [[0], [9], []]
    assert steps[0]["activation"][0] == pytest.approx(0.5, abs=0.01)


def dark(image):
    grey = np.asarray(image.convert("L"))
    rows, columns = np.nonzero(grey < 140)
    return (int(columns.mean() * 8 / grey.shape[1]), int(rows.mean() * 8 / grey.shape[0]))


def test_a_film(keep):
    with Image.open(keep("a.gif")) as film:
        frames = []
        for index in range(film.n_frames):
            film.seek(index)
            frames.append((film.info["duration"], film.convert("L")))
    assert [duration for duration, _ in frames][:2] == [20, 60]
    assert [dark(frame) for _, frame in frames[:2]] == [(0, 0), (1, 1)]
    assert np.asarray(frames[2][1]).min() > 140


def test_a_folder_of_pictures(keep):
    files = sorted(keep("folder").iterdir())
    assert [each.name for each in files] == [f"step-{number:06d}.png" for number in range(3)]
    with Image.open(files[1]) as picture:
        assert dark(picture) == (1, 1)


def test_what_cannot_be_written_is_named(profile, tmp_path):
    path = tmp_path / "a.bmp"
    with raises(SmartTouchError, about="file", value=(path, ".gif", ".json")):
        PatternFile(path, profile)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    with raises(SmartTouchError, about="file", value=tmp_path / "full"):
        PatternFile(tmp_path / "full", profile)
    with raises(SmartTouchError, about="patterns"):
        PatternFile(tmp_path / "a.gif", profile).save()
    for path in (tmp_path / "none" / "a.json", tmp_path / "none" / "a.gif"):
        lost = PatternFile(path, profile)
        lost.watch(step(0))
        with raises(SmartTouchError, about="file", value=path):
            lost.save()


def test_every_class_counts(profile, tmp_path):
    sent = step(3)
    activation = sent.step.tactile.activation.copy()
    activation[Afferent.SAI, 5] = 1.0
    tactile = TactileImage(activation, 0, 1.0)
    patterns = PatternFile(tmp_path / "a.json", profile)
    patterns.watch(replace(sent, step=replace(sent.step, tactile=tactile)))
    patterns.save()
    row = json.loads((tmp_path / "a.json").read_text())["steps"][0]["activation"]
    assert np.flatnonzero(row).tolist() == [3, 5]
