"""Whatever happened to a file: what holds is read, and the rest is one clear sentence."""

import contextlib
import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from smarttouch.base.errors import RecordingError
from smarttouch.running.recording import RecordedRun, load_recording
from smarttouch.running.recording_format import FORMAT

from ..raising import raises
from .forged_recordings import put_together


@pytest.fixture(scope="session")
def content(recording):
    return recording.read_bytes()


@pytest.fixture(scope="session")
def broken_path(tmp_path_factory):
    return tmp_path_factory.mktemp("broken") / "broken.mcap"


def read_all(path):
    """Read all there is to read; return the steps."""
    found = RecordedRun(path)
    steps = list(found.steps())
    assert found.seconds >= 0
    for read in (lambda: found.profile, lambda: found.settings, lambda: found.events):
        with contextlib.suppress(RecordingError):
            read()
    return steps


def test_a_whole_recording(recording, steps, profile, settings):
    found = RecordedRun(recording)
    again = list(found.steps())
    assert found.whole
    assert found.damaged_chunks == 0
    assert [each.index for each in again] == list(range(40))
    for was, now in zip(steps, again, strict=True):
        assert np.array_equal(was.step.input.image, now.step.input.image)
        assert np.array_equal(was.step.sequence.current_ua, now.step.sequence.current_ua)
        assert (was.number, was.step.level) == (now.sent.number, now.step.level)
    assert again[0].step.input.image is again[1].step.input.image
    assert (found.profile, found.settings) == (profile, settings)
    assert found.seconds == pytest.approx(0.78)
    assert found.events == [(5_000_000, "paused"), (5_000_000, "goes on")]


def cuts(content):
    places = {content.index(b"smarttouch"), len(content) // 3, len(content) // 2}
    return sorted(places | {len(content) - back for back in (1, 8, 9, 40, 400, 3000)})


def test_wherever_it_is_cut_what_came_before_is_kept(content, broken_path):
    kept = []
    for place in cuts(content):
        broken_path.write_bytes(content[:place])
        try:
            steps = read_all(broken_path)
        except RecordingError:
            assert place < 4000
            continue
        assert not RecordedRun(broken_path).whole
        assert [each.index for each in steps] == list(range(len(steps)))
        kept.append(len(steps))
    assert kept == sorted(kept)
    assert 5 < kept[0] < 30
    assert kept[-1] == 40


@pytest.mark.parametrize("part", [0.2, 0.4, 0.6, 0.8])
def test_a_flipped_bit_costs_one_chunk(content, steps, broken_path, part):
    chunks = make_reader(BytesIO(content)).get_summary().chunk_indexes
    chunk = chunks[int(part * len(chunks))]
    broken = bytearray(content)
    broken[chunk.chunk_start_offset + int(0.9 * chunk.chunk_length)] ^= 1
    broken_path.write_bytes(broken)
    recording = RecordedRun(broken_path)
    indexes = [step.index for step in recording.steps()]
    assert 0 < len(steps) - len(indexes) <= 3
    assert indexes == sorted(set(indexes))
    assert recording.damaged_chunks == 1
    assert not recording.whole


def test_what_follows_a_damaged_length_is_not_read(content, broken_path):
    chunks = make_reader(BytesIO(content)).get_summary().chunk_indexes
    broken = bytearray(content)
    # The record's opcode, then its length: 8 bytes, little endian.
    broken[chunks[20].chunk_start_offset + 8] ^= 0x80
    broken_path.write_bytes(broken)
    steps = read_all(broken_path)
    assert [step.index for step in steps] == list(range(len(steps)))
    assert 5 < len(steps) < 40
    arrays = load_recording(broken_path).arrays
    assert len(arrays.step) == len(steps)


def test_what_is_none_of_ours(broken_path, tmp_path):
    for content in (b"", b"\x89MCAP", b"precious", b"\x89MCAP0\r\n"):
        broken_path.write_bytes(content)
        with raises(RecordingError, value=broken_path):
            RecordedRun(broken_path)
    for path in (tmp_path / "none.mcap", tmp_path):
        with raises(RecordingError, value=path):
            RecordedRun(path)


def described(path, about):
    """Return a recording that has nothing but its description."""
    put_together(path, about, [])
    return RecordedRun(path)


def test_a_recording_of_the_future(broken_path, about):
    with raises(RecordingError, names="format", value="9", allowed=FORMAT):
        described(broken_path, {**about, "format": "9"})


@pytest.mark.parametrize("key", ["profile", "settings", "versions", "started_unix_ns", "digest"])
def test_a_changed_description_is_refused(broken_path, recording, about, key):
    """One digit of a threshold is enough."""
    content, was = recording.read_bytes(), about[key].encode()
    assert content.count(was) == 1
    digit = re.search(rb"[0-9]", was)[0]
    changed = was.replace(digit, b"%d" % ((int(digit) + 1) % 10), 1)
    broken_path.write_bytes(content.replace(was, changed))
    with raises(RecordingError, value=broken_path):
        RecordedRun(broken_path)


@pytest.mark.parametrize(("key", "value"), [("profile", "{}"), ("settings", "{}")])
def test_a_description_without_its_parts(broken_path, about, key, value):
    found = described(broken_path, {**about, key: value})
    with raises(RecordingError, value=broken_path):
        found.profile if key == "profile" else found.run  # noqa: B018, reading it raises


def test_goldens_are_small(goldens):
    for path in goldens:
        assert Path(path).stat().st_size < 80_000
