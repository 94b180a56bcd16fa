"""Recordings hold everything, and nothing recorded is ever lost."""

import base64
import json

import numpy as np
import pytest
from mcap.reader import make_reader

from smarttouch.errors import RecordingError
from smarttouch.live import Sent
from smarttouch.pipeline import Pipeline
from smarttouch.recording import SCHEMAS, Recorder


@pytest.fixture
def steps(profile, bank, make_frame, patch):
    pipeline = Pipeline(profile, bank)
    frames = (make_frame(patch(), time_ns=k * 10**9) for k in range(3))
    return [Sent(pipeline.process(frame), k + 1, 99.0) for k, frame in enumerate(frames)]


def test_all_that_went_in_comes_out(tmp_path, steps):
    recorder = Recorder(tmp_path / "run.mcap", {"seed": "0", "version": "x"})
    for sent in steps:
        recorder.record(sent, sent.number - 1, 0)
    recorder.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        found = {topic: [] for topic in SCHEMAS}
        for _, channel, message in reader.iter_messages():
            found[channel.topic].append(json.loads(message.data))
        assert [entry.metadata["seed"] for entry in reader.iter_metadata()] == ["0"]
    assert {topic: len(entries) for topic, entries in found.items()} == dict.fromkeys(SCHEMAS, 3)
    last = steps[-1].step
    image = np.frombuffer(base64.b64decode(found["/frame"][-1]["data"]), np.uint8)
    assert np.array_equal(image.reshape(64, 64), last.frame.image)
    current = np.frombuffer(base64.b64decode(found["/sequence"][-1]["current_ua"]), "<i2")
    assert np.array_equal(current.reshape(-1, 64), last.sequence.current_ua)
    assert found["/board"][-1] == {"sent": 3, "acknowledged": 2, "refused": 0, "latency_us": 99.0}
    for topic, entries in found.items():
        assert set(entries[0]) == set(SCHEMAS[topic][1])


def test_an_existing_file_is_kept(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="never overwritten"):
        Recorder(path, {})
    assert path.read_text() == "precious"


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(RecordingError, match="cannot record to"):
        Recorder(tmp_path / "none" / "run.mcap", {})


def test_a_full_disk_is_said_and_what_was_written_stays(tmp_path, steps, monkeypatch):
    recorder = Recorder(tmp_path / "run.mcap", {})

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder._writer, "add_message", full)
    recorder.record(steps[0], 0, 0)
    with pytest.raises(RecordingError, match="cut short: No space left"):
        recorder.close()
    assert (tmp_path / "run.mcap").exists()
