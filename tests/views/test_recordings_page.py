"""Recordings in a real browser and as files: pictures are those of the steps recorded."""

import base64
import json
from urllib.error import HTTPError
from urllib.request import urlopen
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.array_picture import current_colors
from smarttouch.base.errors import RecordingError
from smarttouch.running.recording_reader import Recording
from smarttouch.views.recorded_pictures import RecordingIndex
from smarttouch.views.recordings_page import RecordingsPage, save_view

from ..raising import raises
from .browser import opened, violations
from .conftest import Spots, colors, drawn, strongest

STEPS = 120
PLAY = """data => new Promise((played, failed) => {
  const video = document.createElement('video');
  video.muted = true;
  video.onerror = () => failed(video.error.message);
  video.onended = () => played([video.duration, video.videoWidth, video.currentTime]);
  video.src = `data:video/mp4;base64,${data}`;
  document.body.append(video);
  video.play();
})"""


@pytest.fixture(scope="module")
def recorded(profile, tmp_path_factory):
    """A recording, and its steps."""
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    display = st.open_display("simulated:", profile)
    recorder = st.Recorder(path)
    st.run(Spots(profile), display, seconds=STEPS / 50, rate_hz=50, listeners=[recorder])
    return path, [*Recording(path).steps()]


@pytest.fixture
def tape(recorded):
    with RecordingIndex(recorded[0]) as made:
        made.wait()
        yield made


@pytest.fixture(scope="module")
def address(recorded):
    """Address of a page with the same recording twice."""
    with RecordingsPage([recorded[0]] * 2) as page:
        for each in page.tapes:
            each.wait()
        yield page.address


def test_pictures_of_a_tape_are_those_recorded(tape, recorded):
    steps = recorded[1]
    assert len(tape) == len(steps) == STEPS
    for index in (100, 0, STEPS - 1):
        picture = json.loads(tape.picture(index))
        assert picture["number"] == steps[index].sent.number
        assert picture["slots"] == steps[index].step.sequence.slots
    for index in (-1, STEPS):
        with pytest.raises(IndexError):
            tape.picture(index)
    assert [each["text"] for each in tape.message()["events"]][:2] == ["intensity 1.00", "mode RA"]


def test_what_is_cut_is_shown_as_far_as_it_goes(recorded, tmp_path):
    path = tmp_path / "cut.mcap"
    data = recorded[0].read_bytes()
    path.write_bytes(data[: 2 * len(data) // 3])
    with RecordingIndex(path) as tape:
        tape.wait()
        assert 0 < len(tape) < STEPS
        assert tape.message()["wrong"]


def test_an_hour_is_loaded(address, browser):
    def long(route):
        told = route.fetch().json()
        for each in told:
            each["times_s"] = [number / 50 for number in range(180_000)]
        route.fulfill(json=told)

    page = browser.new_page()
    page.route("**/recordings?from=0", long)
    page.goto(address)
    page.wait_for_selector("#time[max='179999']")
    page.close()


def test_frame_100_is_as_it_was(recorded, profile, address, browser):
    step = recorded[1][100].step
    with opened(browser, address) as page:
        page.wait_for_selector(".electrodes[data-step='0']")
        page.evaluate(
            "time => { const line = document.getElementById('time');"
            "line.value = time; line.dispatchEvent(new Event('input')); }", 100
        )  # fmt: skip
        page.wait_for_selector(".side:nth-child(2) .electrodes[data-step='100']")
        current = strongest(step.sequence)
        for side in (1, 2):
            canvas = f".side:nth-child({side}) .electrodes"
            found = drawn(page, profile, canvas)
            assert np.array_equal(found["colors"], colors(current, profile))
        grey = page.evaluate(
            "() => { const canvas = document.querySelector('.sensor');"
            "return [...canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height)"
            ".data].filter((_, at) => at % 4 == 0); }"
        )
        assert np.array_equal(np.reshape(grey, step.input.image.shape), step.input.image)
        page.click("#slot-after")
        found = drawn(page, profile, ".electrodes")
        assert np.array_equal(found["colors"], colors(step.sequence.current_ua[0], profile))
        # Also where a button has the focus.
        page.keyboard.press("ArrowRight")
        page.wait_for_selector(".electrodes[data-step='101']")
        page.click(".jumps button")
        page.wait_for_selector(".electrodes[data-step='0']")
        page.click("#play")
        page.wait_for_selector(".electrodes:not([data-step='0'])")
        page.set_viewport_size({"width": 360, "height": 740})
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        with urlopen(address.replace("view.html", "film/0/100-119.mp4"), timeout=30) as film:
            data = base64.b64encode(film.read()).decode()
        blank = browser.new_page()
        duration_s, wide, end_s = blank.evaluate(PLAY, data)
        assert duration_s == pytest.approx(10 / 25, abs=0.05)
        assert wide > 100
        assert end_s == pytest.approx(duration_s, abs=0.05)
        assert violations(page) == []


def test_what_a_finger_answers_is_that_of_a_tenth_of_a_second(tape, recorded, address):
    steps = recorded[1]
    found = json.loads(tape.response(100))
    feeling = tape.finger.feel([each.step for each in steps[96:101]])
    counts = np.frombuffer(base64.b64decode(found["counts"]), np.uint8)
    assert np.array_equal(counts, np.minimum(feeling.counts, 255))
    assert found["spikes"] == feeling.counts.sum() > 0
    series = tape.message(100)["series"][0]
    current = np.abs(steps[100].step.sequence.current_ua).max()
    assert series[0] == pytest.approx(current / 1000)
    with urlopen(address.replace("view.html", "felt/0/100"), timeout=60) as answer:
        assert json.loads(answer.read()) == found


def test_what_is_not_there_is_not_found(address):
    for path in ("step/0/120", "step/2/0", "step/0/x", "felt/0/120", "view/0/0.gif",
                 "view/0/0.png?slot=99", "film/0/5-4.mp4", "film/0/500-600.mp4"):  # fmt: skip
        with pytest.raises(HTTPError) as refused:
            urlopen(address.replace("view.html", path), timeout=10)
        assert refused.value.code == 404
        refused.value.close()


def test_saved_views(recorded, profile, tmp_path):
    path, steps = recorded
    sequence = steps[100].step.sequence
    for kind in ("png", "svg", "mp4"):
        save_view(path, tmp_path / f"a.{kind}", 100)
    expected = colors(strongest(sequence), profile)
    assert np.array_equal(current_colors(strongest(sequence), profile.full_ma.max()), expected)
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    found = [each.get("fill") for each in root.iter() if each.tag.endswith("circle")]
    assert found == [f"rgb({','.join(map(str, each))})" for each in expected]
    image = cv2.cvtColor(cv2.imread(str(tmp_path / "a.png")), cv2.COLOR_BGR2RGB)
    scale = image.shape[1] / profile.electrodes.extent_mm[0]
    x, y = np.rint((profile.electrodes.position_mm + 8) * scale).astype(int).T
    assert np.array_equal(image[y, x], expected)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    seen = []
    while (image := video.read()[1]) is not None:
        seen.append(image)
    video.release()
    assert len(seen) in (9, 10)
    first = cv2.cvtColor(seen[0], cv2.COLOR_BGR2RGB)[y, x].astype(int)
    assert np.abs(first - expected).max() < 40


def test_what_cannot_be_saved_is_refused(recorded, tmp_path):
    path = recorded[0]
    with raises(RecordingError, about="save"):
        save_view(path, tmp_path / "a.gif")
    with raises(RecordingError, about="step", value=500, allowed=STEPS):
        save_view(path, tmp_path / "a.png", 500)
    for count in (0, 3):
        with raises(RecordingError, about="files", value=count):
            RecordingsPage([path] * count)
