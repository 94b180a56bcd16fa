"""Nothing recorded is lost, and nobody goes on unrecorded."""

import contextlib
import io
import json
import threading
import time

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from smarttouch.errors import RecordingError
from smarttouch.recording import recorder as module
from smarttouch.recording.reader import Recording
from smarttouch.recording.recorder import Recorder, about_run, new_writer
from smarttouch.recording.schemas import SCHEMAS

STARTED_NS = 1_700_000_000 * 10**9


@pytest.fixture
def recorder(tmp_path, about):
    made = Recorder(tmp_path / "run.mcap", about, STARTED_NS)
    yield made
    with contextlib.suppress(RecordingError):
        made.close()


def full(*_, **__):
    raise OSError(28, "No space left on device")


def until(true, within_s=20.0):
    """Wait for something; the deadline is for a test that would fail anyway."""
    deadline = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_the_plain_reader_reads_it(recording, steps):
    found = {topic: [] for topic in SCHEMAS}
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            found[channel.topic].append((message, json.loads(message.data)))
            assert (schema.name, schema.encoding) == (SCHEMAS[channel.topic][0], "jsonschema")
        (entry,) = reader.iter_metadata()
        summary = reader.get_summary()
    assert entry.name == "smarttouch"
    assert json.loads(entry.metadata["settings"])["subject"] == "S7"
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 2
    counts = {topic: len(messages) for topic, messages in found.items()}
    assert counts == {
        "/frame": 20, "/finger": 40, "/tactile": 40, "/request": 0, "/sequence": 40, "/volts": 0,
        "/board": 40, "/event": 2,
    }  # fmt: skip
    message, finger = found["/finger"][7]
    assert message.log_time == message.publish_time == STARTED_NS + 7 * 20_000_000
    assert finger["force_n"] == 1 / 3
    _, event = found["/event"][1]
    assert event["message"] == "goes on"
    assert event["timestamp"] == {"sec": 1_700_000_000, "nsec": 5_000_000}
    assert found["/board"][-1][1]["sent"] == steps[-1].number


def test_an_existing_file_is_kept(tmp_path, about):
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match="never overwritten"):
        Recorder(path, about, 0)
    assert path.read_text() == "precious"


def test_a_folder_that_is_not_there(tmp_path, about):
    with pytest.raises(RecordingError, match="cannot record to"):
        Recorder(tmp_path / "none" / "run.mcap", about, 0)


def test_what_was_handed_over_is_on_the_disk_soon(recorder, tmp_path, steps):
    recorder.record(steps[0], 0, 0)
    recorder.event(0, "paused")
    until(lambda: len(list(Recording(tmp_path / "run.mcap").steps())) == 1)
    until(lambda: list(Recording(tmp_path / "run.mcap").events()) == [(0, "paused")])
    assert not Recording(tmp_path / "run.mcap").whole


def test_a_failure_is_told_at_the_next_step_and_once(recorder, tmp_path, steps, monkeypatch):
    recorder.record(steps[0], 0, 0)
    until(lambda: list(Recording(tmp_path / "run.mcap").steps()))
    monkeypatch.setattr(recorder._writer, "add_message", full)
    recorder.record(steps[1], 0, 0)
    until(lambda: recorder._failure is not None)
    recorder.event(0, "an event is no place to be told")
    with pytest.raises(RecordingError, match="cut short: No space left on device; what was"):
        recorder.record(steps[2], 0, 0)
    recorder.close()
    assert len(list(Recording(tmp_path / "run.mcap").steps())) == 1


def test_a_failure_that_nobody_heard_of_is_told_at_the_end(recorder, steps, monkeypatch):
    monkeypatch.setattr(recorder._writer, "finish", full)
    recorder.record(steps[0], 0, 0)
    with pytest.raises(RecordingError, match="cut short"):
        recorder.close()
    recorder.close()


def test_whatever_goes_wrong_is_told(recorder, steps, monkeypatch):
    def broken(*_):
        raise ValueError("this cannot be written")

    monkeypatch.setattr(recorder._encoder, "messages", broken)
    recorder.record(steps[0], 0, 0)
    with pytest.raises(RecordingError, match="this cannot be written"):
        recorder.close()


def test_a_disk_that_is_too_slow_ends_the_run(recorder, steps, monkeypatch):
    goes_on = threading.Event()
    monkeypatch.setattr(recorder, "_write", lambda _: goes_on.wait(20))
    monkeypatch.setattr(module, "MOST_WAITING", 3)

    def run():
        for sent in steps:
            recorder.record(sent, 0, 0)

    with pytest.raises(RecordingError, match="3 frames wait for the disk"):
        run()
    goes_on.set()


def test_its_thread_ends_with_it(recorder):
    recorder.close()
    assert not any(thread.name == "recorder" for thread in threading.enumerate())


def test_indexes_are_kept_as_bytes():
    """An afternoon has hundreds of thousands: mcap must still keep them where we look."""
    assert getattr(Writer(io.BytesIO()), module._INDEXES) == []
    assert isinstance(getattr(new_writer(io.BytesIO()), module._INDEXES), module._PackedIndexes)


def test_about_says_with_what_it_was_made(profile):
    about = about_run(profile, {"subject": "S7"}, 17)
    assert about["started_unix_ns"] == "17"
    assert set(json.loads(about["versions"])) == {
        "smarttouch", "python", "numpy", "opencv", "scipy", "mcap", "platform",
    }  # fmt: skip
    assert type(profile).model_validate_json(about["profile"]) == profile
