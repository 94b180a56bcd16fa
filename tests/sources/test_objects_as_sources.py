"""Tests of objects that programs pass as sources, and contract tests of each kind of source."""

import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import smarttouch
from smarttouch.base.errors import SmartTouchError, SourceError
from smarttouch.profile import load_profile
from smarttouch.running.replay_check import assert_replays
from smarttouch.sources import open_source, source_of, source_url
from smarttouch.sources.serial_sensors import encode_frame
from smarttouch.sources.source_contract import (
    Frame,
    OpticalSource,
    Stimulus,
    checked_activation,
    gray_image,
)
from smarttouch.testing.source_contracts import SourceContract

from ..support.checks import raises
from .test_image_sequences import write_clip

GRAY = np.arange(64, dtype=np.uint8).reshape(8, 8)


@pytest.mark.parametrize(("image", "gray"), [
    (GRAY, GRAY),
    (GRAY[:, :, None], GRAY),
    (np.dstack([GRAY] * 3), GRAY),
    (np.dstack([GRAY] * 3 + [np.full_like(GRAY, 255)]), GRAY),
    (np.dstack([GRAY] * 3 + [np.zeros_like(GRAY)]), np.full_like(GRAY, 255)),
    (GRAY > 31, np.where(GRAY > 31, 255, 0)),
    (np.full((2, 2, 3), (255, 0, 0), np.uint8), np.full((2, 2), 76)),
])  # fmt: skip
def test_what_is_certain_is_converted(image, gray):
    made = gray_image(image, "mine:")
    assert made.dtype == np.uint8
    np.testing.assert_array_equal(made, gray)


@pytest.mark.parametrize("image", [
    np.uint8(3), GRAY[0], GRAY[:0], np.zeros((2, 2, 2), np.uint8), np.zeros((1, 2, 2, 3), np.uint8),
    GRAY.astype(float), GRAY.astype(np.int64), np.full((2, 2), "a"),
])  # fmt: skip
def test_what_is_not_certain_is_one_sentence(image):
    with raises(SourceError, names="mine:"):
        gray_image(image, "mine:")


@pytest.mark.parametrize(
    "activation",
    [
        np.full((3, 64), np.nan), np.full((3, 64), 1.5), np.full((3, 64), -0.1),
        np.zeros((64, 3)), np.zeros(64), np.zeros((3, 63)), None, [[0] * 64] * 3,
        np.zeros((3, 64), complex),
    ],
)  # fmt: skip
def test_activation_is_a_number_from_0_to_1_for_each_electrode(activation):
    with raises(SourceError, names="activation"):
        checked_activation(activation, "mine:", 64)


class Mine(OpticalSource):
    """Source of a user's program; `read` returns the object given at construction."""

    knows_force = True

    def __init__(self, returned):
        super().__init__("mine")
        self.returned = returned

    def read(self, time_ns):
        return self.returned


@pytest.mark.parametrize("returned", [GRAY, 3, "text", [GRAY], (GRAY, 0.9)])
def test_what_a_source_returns_is_checked(returned):
    with raises(SourceError, names="source") as caught:
        smarttouch.run(Mine(returned), "memory:")
    assert "mine" in str(caught.value)


def frames_of(source, **options):
    found = []
    smarttouch.run(
        source, "memory:", seconds=0.2, listeners=[lambda each: found.append(each.step.input)],
        **options,
    )  # fmt: skip
    return found


def test_a_run_takes_what_is_at_hand(tmp_path):
    images = np.stack([GRAY, GRAY.T, 255 - GRAY])
    for given in (images, list(images), iter(images), (Frame(each, 0) for each in images)):
        shown = frames_of(given)
        np.testing.assert_array_equal([each.image for each in shown], images)
        assert [(each.number, each.age_ns) for each in shown] == [(0, 0), (1, 0), (2, 0)]
    path = tmp_path / "page.png"
    cv2.imwrite(str(path), np.full((200, 200), 255, np.uint8))
    assert frames_of("text:Hello")[0].image.shape == (64, 64)
    recorded = tmp_path / "run.mcap"
    smarttouch.run("text:a", "simulated:", seconds=0.1, listeners=[smarttouch.Recorder(recorded)])
    assert len(frames_of(recorded)) == len(frames_of(str(recorded))) > 2
    profile = smarttouch.load_profile("electric-mouse")
    assert len(list(smarttouch.steps("text:a", profile, seconds=0.1))) == 5


@pytest.mark.parametrize("given", [
    None, 3, GRAY, b"text:a", {"image": GRAY}, "lettr.png", "nothing:there", 0.5,
    "page:nothing.png", "text:", "frames:nothing", "video:nothing.avi", "recording:nothing.mcap",
])  # fmt: skip
def test_what_is_no_source_is_one_sentence(given, profile):
    with raises(SmartTouchError):
        source_of(given, profile)


class Halves:
    """Imaging function that shows the left half of an image to RA and the right half to SAI."""

    def __call__(self, frame, electrodes):
        columns = electrodes.position_mm[:, 0]
        left = columns < columns.mean()
        dark = np.array([1 - frame.image[:, :4].mean() / 255, 1 - frame.image[:, 4:].mean() / 255])
        return np.stack([dark[0] * left, dark[1] * ~left, 0 * left])


def test_imaging_of_ones_own_and_its_recording(tmp_path):
    path, found = tmp_path / "own.mcap", []
    images = [np.full((8, 8), 255 - 10 * step, np.uint8) for step in range(20)]
    smarttouch.run(
        images, "simulated:", imaging=Halves(), mode="natural",
        listeners=[smarttouch.Recorder(path), found.append],
    )  # fmt: skip
    assert len(found) == 20
    last = found[-1].tactile.activation
    for row in last[:2]:
        np.testing.assert_allclose(np.unique(row), [0, 190 / 255], atol=1e-6)
    assert not last[2].any()
    np.testing.assert_array_equal(found[-1].input.image, images[-1])
    assert_replays(path)


@pytest.mark.parametrize(("source", "imaging", "about"), [
    ([GRAY], lambda frame, electrodes: frame.image, "activation"),
    ([GRAY], lambda frame, electrodes: np.full((3, len(electrodes)), 2.0), "activation"),
    (Mine(Stimulus(np.zeros((3, 64), np.float32), 0, 0.9)), Halves(), "imaging"),
])  # fmt: skip
def test_imaging_that_makes_no_activation_is_refused(source, imaging, about):
    with raises(SourceError, names=about):
        smarttouch.run(source, "memory:", imaging=imaging)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("scan.png", "clip.MP4", "run.mcap", "why?", "notes.txt"):
        Path(name).write_text("some words", encoding="utf-8")
    Path("frames").mkdir()


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("name", "url"), [
    ("scan.png", "page:scan.png"), ("scan.png?dpi=300", "page:scan.png?dpi=300"),
    ("./scan.png", "page:./scan.png"), ("clip.MP4", "video:clip.MP4"),
    ("run.mcap", "recording:run.mcap"), ("frames", "frames:frames"), ("why?", "page:why?"),
    ("Hello", "text:Hello"), ("Is it so?", "text:Is it so?"), ("Note: this", "text:Note: this"),
    ("3:30 p.m.", "text:3:30 p.m."), ("camera:0", "camera:0"), ("radio:5", "radio:5"),
    ("", "text:"),
])  # fmt: skip
def test_one_reading(name, url):
    assert source_url(name) == url


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("name", "named"), [
    ("camera", "camera:"), ("camra", "camera:"), ("gone.png", "gone.png"), ("./gone", "gone"),
    ("gone.png?dpi=300", "gone.png"),
])  # fmt: skip
def test_what_may_be_a_slip_is_not_shown_as_words(name, named):
    with pytest.raises(SourceError, match=named):
        source_url(name)


@pytest.mark.usefixtures("folder")
def test_a_text_file_is_printed():
    profile = load_profile("electric-mouse")
    with open_source("notes.txt", profile) as shown, open_source("some words", profile) as typed:
        assert np.abs(shown.read(0).image - typed.read(0).image.astype(int)).mean() < 3
        assert shown.url == "page:notes.txt"


def page_url(folder):
    grey = np.full((80, 200), 255, np.uint8)
    grey[30:50, 20:180:10] = 0
    Image.fromarray(grey).save(folder / "page.png")
    return f"page:{folder / 'page.png'}"


def folder_url(folder):
    for number in range(40):
        Image.fromarray(np.full((48, 64), 5 * number, np.uint8)).save(folder / f"{number}.png")
    return f"frames:{folder}"


def video_url(folder):
    images = [np.full((48, 64), 5 * number) for number in range(40)]
    return f"video:{write_clip(folder / 'clip.avi', images)}"


RECORDING = Path(__file__).parents[1] / "running/goldens/ra.mcap"


class TestUrls(SourceContract):
    """Contract tests of all kinds of sources that end."""

    @pytest.fixture(autouse=True, params=[
        (page_url, {"page_width_mm": 20.0}), (lambda _: "text:a word", {}),
        (folder_url, {"unpaced": True}), (folder_url, {"fps": 200.0}),
        (video_url, {"unpaced": True}), (lambda _: f"recording:{RECORDING}", {}),
    ])  # fmt: skip
    def _kind(self, request, tmp_path):
        make_url, self.options = request.param
        self.url = make_url(tmp_path)

    def make(self, profile):
        return open_source(self.url, profile, **self.options)


class TestSerialArray(SourceContract):
    ends = False

    @pytest.fixture(autouse=True)
    def _device(self, make_device):
        self.device = make_device(
            lambda number: encode_frame(number, 0, np.full((8, 8), number % 256, np.uint8))
        )

    def make(self, profile):
        return open_source(f"serial-array:{self.device.line.name}", profile)

    def pause(self):
        time.sleep(0.005)
