"""Tests of the recorder: steps reach the disk, and a run ends if recording fails."""

import contextlib
import errno
import json
import os
import random
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from smarttouch.base.errors import RecordingError
from smarttouch.base.events import Note
from smarttouch.running import recorder as module
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording_format import SCHEMAS
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.replay_check import check_recording
from smarttouch.running.step_records import Step, StepResult
from smarttouch.sources.source_contract import Frame

from ..support.checks import raises
from ..support.full import WHOLE
from ..support.processes import Forked
from ..support.runs import until

STARTED_NS = 1_700_000_000 * 10**9


@pytest.fixture
def recorder(tmp_path, about, monkeypatch):
    """Yield a recorder that writes each step to disk at once."""
    monkeypatch.setattr(module, "CHUNK_S", 0.0)
    made = Recorder(tmp_path / "run.mcap")
    made.begin(about, STARTED_NS)
    yield made
    with contextlib.suppress(RecordingError):
        made.close()


def full(*_, **__):
    raise OSError(28, "No space left on device")


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
    assert counts == {"/frame": 20, "/step": 40, "/event": 2}
    message, step = found["/step"][7]
    assert message.log_time == message.publish_time == STARTED_NS + 7 * 20_000_000
    assert step["force_n"] == 1 / 3
    _, event = found["/event"][1]
    assert event["message"] == "goes on"
    assert event["timestamp"] == {"sec": 1_700_000_000, "nsec": 5_000_000}
    assert found["/step"][-1][1]["sent"] == steps[-1].number


def test_another_image_of_the_same_number_is_not_lost(tmp_path, steps, record):
    """If a sensor gives the same number to different images, all these images are recorded."""
    images = [np.full((64, 64), grey, np.uint8) for grey in (10, 10, 200)]
    was = steps[0].step
    made = [
        StepResult(Step(Frame(image, at, number=1), was.tactile, was.sequence, was.mode), at, 0.0)
        for at, image in enumerate(images)
    ]
    recording = RecordedRun(record(tmp_path / "run.mcap", made))
    assert [each.step.input.image[0, 0] for each in recording.steps()] == [10, 10, 200]
    assert len(list(recording.contents("/frame"))) == 2


def test_where_no_recording_can_be(tmp_path, about):
    precious = tmp_path / "run.mcap"
    precious.write_text("precious")
    for path in (precious, tmp_path / "none" / "run.mcap"):
        with raises(RecordingError, value=path):
            Recorder(path).begin(about, 0)
    assert precious.read_text() == "precious"


def test_what_was_handed_over_is_on_the_disk_soon(recorder, tmp_path, steps):
    recorder.step(steps[0])
    recorder.event(Note(0, "paused"))
    until(lambda: len(list(RecordedRun(tmp_path / "run.mcap").steps())) == 1)
    until(lambda: RecordedRun(tmp_path / "run.mcap").events == [(0, "paused")])
    assert not RecordedRun(tmp_path / "run.mcap").whole


def test_a_failure_is_raised_once_at_the_next_step(recorder, tmp_path, steps, monkeypatch):
    recorder.step(steps[0])
    until(lambda: list(RecordedRun(tmp_path / "run.mcap").steps()))
    monkeypatch.setattr(recorder._writer, "add_message", full)
    recorder.step(steps[1])
    until(lambda: recorder._failure is not None)
    recorder.event(Note(0, "an event raises no error"))
    path = tmp_path / "run.mcap"
    with raises(RecordingError, value=path) as caught:
        recorder.step(steps[2])
    assert "No space left on device" in str(caught.value)
    recorder.close()
    assert len(list(RecordedRun(tmp_path / "run.mcap").steps())) == 1


def test_a_failure_without_a_next_step_is_raised_at_the_end(recorder, steps, monkeypatch):
    monkeypatch.setattr(recorder._writer, "finish", full)
    recorder.step(steps[0])
    with raises(RecordingError) as caught:
        recorder.close()
    assert "No space left on device" in str(caught.value)
    recorder.close()


def test_a_disk_that_is_too_slow_ends_the_run(recorder, steps, monkeypatch):
    goes_on = threading.Event()
    monkeypatch.setattr(recorder, "_write", lambda _: goes_on.wait(20))
    monkeypatch.setattr(module, "MOST_WAITING", 3)

    with raises(RecordingError) as caught:
        [recorder.step(sent) for sent in steps]
    assert "3 " in str(caught.value)
    goes_on.set()


def test_its_thread_ends_with_it(recorder):
    recorder.close()
    assert not any(thread.name == "recorder" for thread in threading.enumerate())


def test_what_the_disk_had_is_readable_after_a_power_cut(tmp_path, about, steps, monkeypatch):
    """A file cut to the size that it had at a sync contains all steps before this sync."""
    sizes, fsync, path = [], os.fsync, tmp_path / "run.mcap"

    def note_size(number):
        fsync(number)
        if path.exists() and os.path.samestat(os.fstat(number), path.stat()):
            sizes.append(os.fstat(number).st_size)

    monkeypatch.setattr(module.os, "fsync", note_size)
    monkeypatch.setattr(module, "CHUNK_S", 0.0)
    recorder = Recorder(path)
    recorder.begin(about, STARTED_NS)
    for count, sent in enumerate(steps[:10]):
        recorder.step(sent)
        until(lambda least=count + 2: len(sizes) >= least)
    recorder.close()
    whole = path.read_bytes()
    for count, size in enumerate(sizes[:11]):
        cut = tmp_path / f"cut{count}.mcap"
        cut.write_bytes(whole[:size])
        recording = RecordedRun(cut)
        assert [each.index for each in recording.steps()] == list(range(count))
        assert recording.about == about
        assert not recording.whole


def moved(path):
    path.rename(path.with_name("moved.mcap"))


def replaced(path):
    path.unlink()
    path.write_bytes(b"")


@pytest.mark.parametrize("lose", [moved, replaced, Path.unlink])
def test_a_recording_that_vanishes_is_an_error(recorder, tmp_path, steps, lose):
    path = tmp_path / "run.mcap"
    recorder.step(steps[0])
    lose(path)
    with raises(RecordingError, value=path) as caught:
        recorder.close()
    assert "moved" in str(caught.value)
    recorder.close()


CHILD = Path(__file__).with_name("recorded_child.py")


@contextmanager
def child(*arguments):
    """Yield a process that runs ``recorded_child.py``; kill it at the end."""
    process = Forked(
        [sys.executable, CHILD, *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_killed_program_loses_little(tmp_path, runs):
    for seed in range(runs or (2 if WHOLE else 1)):
        killed(tmp_path / f"{seed}.mcap", random.Random(seed))


def killed(path, draw):
    """Kill a recording program at a random time, and check its recording."""
    told = []
    with child(path) as process:
        # Kill it after three syncs and a random delay.
        while sum(given > 0 for _, given in told) < 3:
            told.append([int(each) for each in process.stdout.readline().split()])
        time.sleep(draw.uniform(0.0, 0.5))
        process.kill()
        told += [[int(each) for each in line.split()] for line in process.stdout]
    last_ns, given = (max(each) for each in zip(*told, strict=True))
    kept = list(RecordedRun(path).steps())
    lost_ms = (last_ns - kept[-1].step.input.time_ns) / 1e6
    print(f"killed at {last_ns / 1e6:.0f} ms: {lost_ms:.1f} ms lost")
    assert [each.index for each in kept] == list(range(len(kept)))
    # Each synced step must be in the file. How soon it is synced depends on the machine's load.
    assert len(kept) >= given > 2
    assert not RecordedRun(path).whole
    check = check_recording(path)
    assert check.exact, check.describe()
    assert check.left_out


def test_a_disk_that_fills_up_is_one_sentence_and_what_it_took_stays(tmp_path):
    path = tmp_path / "run.mcap"
    with child(path, 200_000) as process:
        *_, sentence, closed = process.communicate(timeout=110)[0].splitlines()
        assert process.returncode == 0
    assert sentence.startswith(f"{path} ")
    assert os.strerror(errno.EFBIG) in sentence
    assert closed == "closed"
    assert path.stat().st_size <= 200_000
    kept = list(RecordedRun(path).steps())
    assert [each.index for each in kept] == list(range(len(kept)))
    assert len(kept) > 3
    assert check_recording(path).exact
