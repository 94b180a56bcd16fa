"""Recordings in Foxglove: tactile images in colors, and a layout of their topics."""

import base64
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.afferent import CLASS_COLORS
from smarttouch.running.recording_reader import Recording
from smarttouch.running.step_encoder import class_colors, tactile_picture

LAYOUT = Path(__file__).parents[2] / "docs" / "how-to" / "foxglove-layout.json"


def decoded(message):
    return cv2.imdecode(np.frombuffer(base64.b64decode(message["data"]), np.uint8), 1)[..., ::-1]


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61", "line-8"])
def test_each_electrode_has_the_color_of_its_class(name):
    electrodes = st.load_profile(name).electrodes
    image = tactile_picture(electrodes)
    for afferent, color in CLASS_COLORS.items():
        activation = np.zeros((3, len(electrodes)), np.float32)
        activation[afferent, 5] = 1
        drawn = image.raster(class_colors(activation))
        inked = (drawn != 255).any(axis=2)
        rows, columns = np.nonzero(inked)
        assert len(rows) > 10
        assert {tuple(each) for each in drawn[inked].tolist()} == {
            tuple(int(color[at : at + 2], 16) for at in (1, 3, 5))
        }
        place = (np.array([columns.mean(), rows.mean()]) + 0.5) / drawn.shape[1::-1] - 0.5
        np.testing.assert_allclose(
            place * electrodes.extent_mm, electrodes.position_mm[5], atol=electrodes.pitch_mm / 5
        )


def test_a_recording_shows_its_tactile_images(tmp_path, profile):
    path = tmp_path / "run.mcap"
    display = st.open_display("simulated:", profile)
    results = []
    source = st.open_source("text:a", profile)
    st.run(source, display, listeners=[st.Recorder(path), results.append])
    recording = Recording(path)
    images = [
        json.loads(each.data) for topic, each in recording.messages() if topic == "/tactile_image"
    ]
    changes = [
        result.tactile.activation
        for before, result in zip([None, *results], results, strict=False)
        if before is None or (before.tactile.activation != result.tactile.activation).any()
    ]
    assert len(images) == len(changes) > 5
    expected = tactile_picture(profile.electrodes).raster(class_colors(changes[-1]))
    np.testing.assert_array_equal(decoded(images[-1]), expected)
    assert len([*recording.steps()]) == len(results)


def test_the_layout_names_what_there_is(tmp_path):
    path = tmp_path / "run.mcap"
    st.run("text:a", "simulated:", seconds=0.1, listeners=[st.Recorder(path)])
    recorded = {topic: json.loads(each.data) for topic, each in Recording(path).messages()}
    layout = json.loads(LAYOUT.read_text("utf-8"))
    paths = []
    for each in layout["configById"].values():
        paths += [each["imageMode"]["imageTopic"]] if "imageMode" in each else []
        paths += [each["topicToRender"]] if "topicToRender" in each else []
        paths += [path["value"] for path in each.get("paths", ())]
    assert len(paths) == 7
    for path in paths:
        topic, _, key = path.partition(".")
        assert not key or key in recorded[topic]
        assert topic in recorded

    def panels(part):
        if isinstance(part, str):
            return [part]
        return [*panels(part["first"]), *panels(part["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
