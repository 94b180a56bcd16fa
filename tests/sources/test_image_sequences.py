"""Tests of videos and folders of images, at their frame rate or one image per read."""

import math
import os
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from smarttouch.base.errors import SourceError
from smarttouch.sources import open_source
from smarttouch.sources.image_sequences import MOST_DECODED, Clip, ClipSource

from ..support.checks import numbers_in, raises
from ..support.full import WHOLE

SECOND = 1_000_000_000


def write_clip(path, images, rate_hz=200.0, codec="MJPG"):
    """Write a video of gray images; return its path. An empty video has 48 x 64 pixels."""
    rows, columns = images[0].shape if images else (48, 64)
    fourcc = cv2.VideoWriter.fourcc(*codec)
    writer = cv2.VideoWriter(str(path), fourcc, rate_hz, (columns, rows))
    assert writer.isOpened()
    for image in images:
        writer.write(cv2.cvtColor(image.astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def clip_of_levels(count, rate_hz):
    """Return a clip whose image n has gray level n, and the list of images decoded so far."""
    decoded = []

    def image(number):
        decoded.append(number)
        return np.full((8, 8), number, np.uint8)

    images = (partial(image, number) for number in range(count))
    return Clip("levels", rate_hz, 0, images), decoded


@pytest.fixture
def write_video(tmp_path):
    """Return a function that writes a video whose field moves right by two pixels per frame."""
    random = np.random.default_rng(0).integers(0, 2, (48, 300)).astype(np.float32)
    page = np.clip(6 * (cv2.GaussianBlur(255 * random, (0, 0), 2.5) - 100), 0, 255)

    def write(name="clip.avi", frames=40, rate_hz=200.0, codec="MJPG"):
        images = [page[:, 2 * number : 2 * number + 64] for number in range(frames)]
        return write_clip(tmp_path / name, images, rate_hz, codec)

    return write


@pytest.fixture
def folder(tmp_path):
    """Return a folder of images whose gray level is ten times their index in natural order."""
    for number, name in enumerate(["1.png", "2.pgm", "03.bmp", "10.tif", "b2.jpg", "b10.png"]):
        Image.fromarray(np.full((6, 8), 10 * number, np.uint8)).save(tmp_path / name)
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / "._1.png").write_bytes(b"of a Mac")
    return tmp_path


def levels(sensor, step_ns=0):
    """Read a source to its end, every ``step_ns``; return the mean gray levels of its images."""
    found, time_ns = [], 0
    with sensor:
        while (frame := sensor.read(time_ns)) is not None:
            found.append(round(float(frame.image.mean())))
            time_ns += step_ns
    return found


def test_a_video_frame_by_frame(profile, write_video):
    with open_source(f"video:{write_video()}", profile, unpaced=True) as sensor:
        frames = []
        while (frame := sensor.read(7)) is not None:
            frames.append(frame)
        assert sensor.read(7) is None
    assert [frame.number for frame in frames] == list(range(40))
    assert (sensor.frames, sensor.dropped_frames, sensor.notes) == (40, 0, [])
    last = frames[-1]
    assert last.image.shape == (48, 64)
    assert (last.time_ns, last.age_ns, last.stale) == (7, 0, False)
    assert math.isnan(last.force_n)
    pixel_mm = profile.optics.field_width_mm / 64
    assert last.pose.x_mm == pytest.approx(78 * pixel_mm, rel=0.02)


def test_a_video_at_its_pace(profile, write_video):
    """Reading a 200 Hz video at 80 Hz drops images. The times given to `read` decide which ones."""
    with open_source(f"video:{write_video()}", profile) as sensor:
        assert sensor.duration_s == pytest.approx(0.2)
        frames = [sensor.read(12_500_000 * count) for count in range(16)]
        assert [sensor.read(200_000_000).number, sensor.read(200_000_000)] == [39, None]
    assert [frame.number for frame in frames] == [5 * count // 2 for count in range(16)]
    assert [frame.age_ns for frame in frames[:3]] == [0, 2_500_000, 0]
    assert (sensor.frames, sensor.dropped_frames) == (40, 23)
    # The position includes the motion in dropped images.
    pixel_mm = profile.optics.field_width_mm / 64
    assert frames[-1].pose.x_mm == pytest.approx(2 * 37 * pixel_mm, rel=0.02)


@pytest.mark.parametrize("unpaced", [True, False])
def test_a_video_that_breaks_off_ends_there(profile, write_video, capfd, unpaced):
    path = write_video()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    sensor = open_source(f"video:{path}", profile, unpaced=unpaced)
    assert levels(sensor, SECOND // 100)
    assert sensor.read(0) is None
    assert 5 < sensor.frames < 30
    (note,) = sensor.notes
    assert "clip.avi" in note
    assert numbers_in(note) == [sensor.frames, 40]
    assert capfd.readouterr().err == ""


@settings(deadline=None, max_examples=25 if WHOLE else 8)
@given(st.data())
def test_no_damage_crashes(profile, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("damage") / "clip.avi"
    write_clip(path, [np.full((32, 32), 40 * number) for number in range(6)], 100)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place : place + 8] = data.draw(st.binary(max_size=16))
    path.write_bytes(content)
    try:
        sensor = open_source(f"video:{path}", profile, unpaced=True)
        count = len(levels(sensor))
    except SourceError:
        return
    assert sensor.frames == count


@pytest.mark.parametrize(
    "content", [None, b"", bytes(range(256)) * 20, b"hello, I am a text\n" * 20, []]
)
@pytest.mark.parametrize("unpaced", [True, False])
def test_what_is_no_video(profile, tmp_path, capfd, content, unpaced):
    path = tmp_path / "clip.avi"
    if content == []:
        write_clip(path, content)
    elif content is not None:
        path.write_bytes(content)
    with raises(SourceError, value=path):
        open_source(f"video:{path}", profile, unpaced=unpaced)
    assert capfd.readouterr().err == ""


def test_a_folder_in_natural_order(profile, folder):
    found = levels(open_source(f"frames:{folder}", profile, unpaced=True))
    assert found == list(range(0, 60, 10))


def tiny(path, width):
    Image.fromarray(np.zeros((6, width), np.uint8)).save(path)


@pytest.mark.parametrize(("url", "place", "make", "attributes"), [
    ("video:", "", None, {"names": "frames:"}),
    ("frames:notes.txt", "notes.txt", None, {"names": "video:"}),
    ("frames:nowhere", "nowhere", None, {}),
    ("frames:empty", "empty", Path.mkdir, {}),
    ("frames:", "1.png", lambda path: tiny(path, 1), {}),
])  # fmt: skip
def test_what_is_neither_a_video_nor_a_folder(profile, folder, url, place, make, attributes):
    if make is not None:
        make(folder / place)
    scheme, _, opened = url.partition(":")
    if "names" in attributes:
        attributes = {"names": f"{attributes['names']}{folder / opened}"}
    with raises(SourceError, value=folder / place, **attributes):
        open_source(f"{scheme}:{folder / opened}", profile)
    for fps in (0.0, -1.0, math.nan, 1e6):
        with raises(SourceError, value=fps):
            open_source(f"frames:{folder}", profile, fps=fps)


@pytest.mark.parametrize("unpaced", [True, False])
@pytest.mark.parametrize(("name", "damage"), [
    ("b2.jpg", lambda path: path.write_bytes(path.read_bytes()[:200])),
    ("10.tif", lambda path: path.write_bytes(b"hello")),
    ("b10.png", lambda path: tiny(path, 9)),
])  # fmt: skip
def test_a_damaged_image_is_named_when_it_comes(profile, folder, unpaced, name, damage):
    damage(folder / name)
    sensor = open_source(f"frames:{folder}", profile, unpaced=unpaced)
    with raises(SourceError, value=folder / name):
        levels(sensor, SECOND // 100)


@given(
    st.integers(0, 60), st.sampled_from([3.0, 30.0, 200.0]),
    st.lists(st.integers(0, SECOND), min_size=1, max_size=30),
)  # fmt: skip
def test_each_image_is_shown_at_its_time_or_dropped(profile, count, rate_hz, steps):
    clip, decoded = clip_of_levels(count, rate_hz)
    sensor = ClipSource(clip, profile, unpaced=False)
    read, ended = set(), False
    for time_ns in np.cumsum(steps).tolist():
        due, frame = int(time_ns * rate_hz / SECOND), sensor.read(time_ns)
        if frame is not None:
            assert not ended
            assert frame.number == frame.image[0, 0] == min(due, count - 1)
            assert not frame.stale
            read.add(frame.number)
        else:
            ended = True
            assert due >= count
    sensor.close()
    assert sensor.frames == len(read) + sensor.dropped_frames <= count
    assert read <= set(decoded)


def test_images_far_behind_are_not_decoded(profile):
    clip, decoded = clip_of_levels(100, 50.0)
    sensor = ClipSource(clip, profile, unpaced=False)
    sensor.read(0)
    assert sensor.read(SECOND).number == 50
    assert decoded == [0, *range(51 - MOST_DECODED, 51)]
    assert (sensor.frames, sensor.dropped_frames) == (51, 49)


@pytest.mark.parametrize("playlist", [
    "ffconcat version 1.0\nfile pipe.ts\n",
    "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\npipe.ts\n#EXT-X-ENDLIST\n",
])  # fmt: skip
@pytest.mark.parametrize("ending", ["mp4", "m3u8"])
def test_a_playlist_leads_nowhere(tmp_path, profile, playlist, ending):
    os.mkfifo(tmp_path / "pipe.ts")
    path = tmp_path / f"list.{ending}"
    path.write_text(playlist)
    for place in (path, tmp_path / "pipe.ts", Path("/dev/zero")):
        with raises(SourceError, value=place):
            open_source(f"video:{place}", profile)
