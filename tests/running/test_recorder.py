"""Nothing recorded is lost, and no run continues unrecorded."""

import contextlib
import io
import itertools
import json
import os
import queue
import threading
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from smarttouch.base.errors import RecordingError
from smarttouch.running import recorder as module
from smarttouch.running.recorder import RecordingWriter, about_run, new_writer
from smarttouch.running.recording_format import TOPICS
from smarttouch.running.recording_reader import Recording

from ..raising import raises
from ..waiting import until

STARTED_NS = 1_700_000_000 * 10**9


@pytest.fixture
def recorder(tmp_path, about):
    made = RecordingWriter(tmp_path / "run.mcap", about, STARTED_NS)
    yield made
    with contextlib.suppress(RecordingError):
        made.close()


def full(*_, **__):
    raise OSError(28, "No space left on device")


def test_the_plain_reader_reads_it(recording, steps):
    found = {topic: [] for topic in TOPICS}
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            found[channel.topic].append((message, json.loads(message.data)))
            assert (schema.name, schema.encoding) == (TOPICS[channel.topic][0], "jsonschema")
        (entry,) = reader.iter_metadata()
        summary = reader.get_summary()
    assert entry.name == "smarttouch"
    assert json.loads(entry.metadata["settings"])["subject"] == "S7"
    assert len(summary.chunk_indexes) == summary.statistics.chunk_count > 2
    counts = {topic: len(messages) for topic, messages in found.items()}
    assert counts == {
        "/frame": 20, "/finger": 40, "/tactile": 40, "/tactile_image": 0, "/request": 0,
        "/sequence": 40, "/volts": 0, "/board": 40, "/event": 2,
    }  # fmt: skip
    message, finger = found["/finger"][7]
    assert message.log_time == message.publish_time == STARTED_NS + 7 * 20_000_000
    assert finger["force_n"] == 1 / 3
    _, event = found["/event"][1]
    assert event["message"] == "goes on"
    assert event["timestamp"] == {"sec": 1_700_000_000, "nsec": 5_000_000}
    assert found["/board"][-1][1]["sent"] == steps[-1].number


def test_where_no_recording_can_be(tmp_path, about):
    precious = tmp_path / "run.mcap"
    precious.write_text("precious")
    for path in (precious, tmp_path / "none" / "run.mcap"):
        with raises(RecordingError, value=path):
            RecordingWriter(path, about, 0)
    assert precious.read_text() == "precious"


def test_what_was_handed_over_is_on_the_disk_soon(recorder, tmp_path, steps):
    recorder.record(steps[0])
    recorder.event(0, "paused")
    until(lambda: len(list(Recording(tmp_path / "run.mcap").steps())) == 1)
    until(lambda: list(Recording(tmp_path / "run.mcap").events()) == [(0, "paused")])
    assert not Recording(tmp_path / "run.mcap").whole


def test_a_failure_is_raised_once_at_the_next_step(recorder, tmp_path, steps, monkeypatch):
    recorder.record(steps[0])
    until(lambda: list(Recording(tmp_path / "run.mcap").steps()))
    monkeypatch.setattr(recorder._writer, "add_message", full)
    recorder.record(steps[1])
    until(lambda: recorder._failure is not None)
    recorder.event(0, "an event is no place to be told")
    path = tmp_path / "run.mcap"
    with raises(RecordingError, value=path) as caught:
        recorder.record(steps[2])
    assert "No space left on device" in str(caught.value)
    recorder.close()
    assert len(list(Recording(tmp_path / "run.mcap").steps())) == 1


@pytest.mark.parametrize(("place", "error", "words"), [
    (("_writer", "finish"), OSError(28, "full"), "full"),
    (("_encoder", "messages"), ValueError("this cannot be written"), "this cannot be written"),
])  # fmt: skip
def test_a_failure_without_a_next_step_is_raised_at_the_end(
    recorder, steps, monkeypatch, place, error, words
):
    def fail(*_):
        raise error

    inner, name = place
    monkeypatch.setattr(getattr(recorder, inner), name, fail)
    recorder.record(steps[0])
    with raises(RecordingError) as caught:
        recorder.close()
    assert words in str(caught.value)
    recorder.close()


def test_a_disk_that_is_too_slow_ends_the_run(recorder, steps, monkeypatch):
    goes_on = threading.Event()
    monkeypatch.setattr(recorder, "_write", lambda _: goes_on.wait(20))
    monkeypatch.setattr(module, "MOST_WAITING", 3)

    with raises(RecordingError) as caught:
        [recorder.record(sent) for sent in steps]
    assert "3 " in str(caught.value)
    goes_on.set()


def test_its_thread_ends_with_it(recorder):
    recorder.close()
    assert not any(thread.name == "recorder" for thread in threading.enumerate())


def test_indexes_are_kept_as_bytes():
    """An afternoon has hundreds of thousands: mcap must still keep them where we look."""
    assert getattr(Writer(io.BytesIO()), module._INDEXES) == []
    assert isinstance(getattr(new_writer(io.BytesIO()), module._INDEXES), module._PackedIndexes)


def test_the_description_has_the_versions(profile):
    about = about_run(profile, {"subject": "S7"}, 17)
    assert about["started_unix_ns"] == "17"
    assert set(json.loads(about["versions"])) == {
        "smarttouch", "python", "numpy", "opencv", "scipy", "mcap", "platform",
    }  # fmt: skip
    assert type(profile).model_validate_json(about["profile"]) == profile


class ManualQueue:
    """A queue and a clock: what is handed over comes at its time, s, and waiting takes none."""

    def __init__(self, handed):
        self.now_s, self._handed = 0.0, list(handed)
        self._given = threading.Event()

    def monotonic(self):
        return self.now_s

    def qsize(self):
        return 0

    def put(self, item):
        self._given.set()

    def get(self, timeout=None):
        if not self._handed:
            # Only the end is left, whenever it comes.
            self._given.wait()
            return None
        until_s = float("inf") if timeout is None else self.now_s + timeout
        if self._handed[0][0] > until_s:
            self.now_s = until_s
            raise queue.Empty
        due_s, item = self._handed.pop(0)
        self.now_s = max(self.now_s, due_s)
        return item


@contextlib.contextmanager
def manual_clock(handed):
    """Patch the writer's queue and clock by those that the test sets; see `ManualQueue`."""
    told = ManualQueue(handed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module.queue, "SimpleQueue", lambda: told)
        patch.setattr(module.time, "monotonic", told.monotonic)
        yield told, patch


def recorded_by_manual_clock(path, about, handed, takes_s=0.0):
    """Record what comes at its times; return when the disk had how much, from the first on."""
    synced, fsync = [], os.fsync

    def waited_for(number):
        fsync(number)
        if os.path.samestat(os.fstat(number), path.stat()):
            told.now_s += takes_s
            synced.append((told.now_s, os.fstat(number).st_size))

    with manual_clock(handed) as (told, patch):
        patch.setattr(module.os, "fsync", waited_for)
        RecordingWriter(path, about, STARTED_NS).close()
    return synced


def test_nothing_waits_for_the_disk_longer_than_a_second(tmp_path, about, steps):
    """Twenty steps a second, then a pause, a single one, and the end an hour later."""
    at_s = [0.05 * index for index in range(60)] + [10.0, 3600.0]
    handed = [(due_s, sent) for due_s, sent in zip(at_s, itertools.cycle(steps), strict=False)]
    path = tmp_path / "run.mcap"
    first, *synced = recorded_by_manual_clock(path, about, handed)
    assert first[0] == 0.0, "the settings, before anything is recorded"
    times = [time_s for time_s, _ in synced]
    assert times[:3] == pytest.approx([1.0, 2.05, 3.1], abs=0.051)
    assert times[3] == pytest.approx(11.0)
    # What comes last is on the disk when the recording is closed.
    assert len(times) == 5
    assert synced[-1][1] == path.stat().st_size
    for number, due_s in enumerate(at_s[:-1]):
        after = next(time_s for time_s in times if time_s >= due_s)
        assert after - due_s <= module.SYNC_S + 1e-6, number


def test_nothing_waits_for_the_system_longer_than_a_moment(tmp_path, about, steps):
    """A killed program loses little: all is given to the system within `FLUSH_S`."""
    at_s = [0.01 * index for index in range(50)] + [5.0]
    given, flush = [], RecordingWriter._flush

    def flush_and_tell(recorder):
        flush(recorder)
        given.append((told.now_s, recorder._index))

    with manual_clock([(due_s, steps[0]) for due_s in at_s]) as (told, patch):
        patch.setattr(RecordingWriter, "_flush", flush_and_tell)
        RecordingWriter(tmp_path / "run.mcap", about, STARTED_NS).close()
    assert len(given) < 20, "several steps share a chunk"
    # The last one goes with the end of the file.
    for number, due_s in enumerate(at_s[:-1]):
        after = next(time_s for time_s, count in given if count > number)
        assert after - due_s <= module.FLUSH_S + 0.011


def test_a_slow_disk_is_waited_for_once_a_second_at_most(tmp_path, about, steps):
    handed = [(0.05 * index, steps[index % 40]) for index in range(100)]
    synced = recorded_by_manual_clock(tmp_path / "run.mcap", about, handed, takes_s=0.4)
    times = [time_s for time_s, _ in synced]
    assert all(after - before >= 1.3 for before, after in itertools.pairwise(times[1:-1]))
    assert len(times) in (5, 6)


def test_what_the_disk_had_is_readable_after_a_power_cut(tmp_path, about, steps):
    """The file cut where it ended when the disk was last waited for: nothing before is lost."""
    handed = [(0.07 * index, sent) for index, sent in enumerate(steps)]
    handed += [(3.0, (5_000_000, "paused"))]
    path = tmp_path / "run.mcap"
    synced = recorded_by_manual_clock(path, about, handed)
    whole, found = path.read_bytes(), []
    for number, (time_s, size) in enumerate(synced[:-1]):
        cut = tmp_path / f"cut{number}.mcap"
        cut.write_bytes(whole[:size])
        kept = list(Recording(cut).steps()) if number else []
        due = [index for index in range(len(steps)) if 0.07 * index <= time_s - 1e-9]
        assert [each.index for each in kept] == due[: len(kept)]
        assert len(due) - len(kept) <= 1
        assert Recording(cut).about.items() >= about.items()
        assert not Recording(cut).whole
        found.append(len(kept))
    assert found[0] == 0
    assert found == sorted(set(found))
    assert len(found) == 3


def test_a_disk_that_does_not_take_it_ends_the_run(recorder, steps, monkeypatch):
    monkeypatch.setattr(module.os, "fsync", full)
    monkeypatch.setattr(module, "SYNC_S", 0.0)
    recorder.record(steps[0])
    until(lambda: recorder._failure is not None)
    with raises(RecordingError):
        recorder.record(steps[1])


def moved(path):
    path.rename(path.with_name("moved.mcap"))


def replaced(path):
    path.unlink()
    path.write_bytes(b"")


@pytest.mark.parametrize("lose", [moved, replaced, Path.unlink])
@pytest.mark.parametrize("late", [False, True])
def test_a_recording_that_vanishes_is_an_error(recorder, tmp_path, steps, monkeypatch, lose, late):
    """While it is written, and where only its end shows it; what was moved away is whole."""
    path = tmp_path / "run.mcap"
    recorder.record(steps[0])
    lose(path)
    if not late:
        monkeypatch.setattr(module, "SYNC_S", 0.0)
        recorder.record(steps[1])
        until(lambda: recorder._failure is not None)
    with raises(RecordingError, value=path):
        recorder.close() if late else recorder.record(steps[2])
    recorder.close()
    if (tmp_path / "moved.mcap").exists():
        assert Recording(tmp_path / "moved.mcap").whole
