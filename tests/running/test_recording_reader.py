"""Tests of `RecordedRun`: intact parts of a damaged file are read, and errors are one sentence."""

import contextlib
import json
import math
import re
from dataclasses import asdict, replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

import smarttouch as st
from smarttouch.base.errors import RecordingError
from smarttouch.kernels.bank import load_bank
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recording_format import (
    FORMAT,
    SCHEMAS,
    StepDecoder,
    event_message,
    image_message,
    step_message,
)
from smarttouch.running.recording_reader import RecordedRun, load_recording
from smarttouch.running.step_records import Step, StepResult
from smarttouch.sources.source_contract import Frame, Pose, Stimulus

from ..support.checks import raises
from .forged_recordings import put_together


@pytest.fixture(scope="session")
def content(recording):
    return recording.read_bytes()


@pytest.fixture(scope="session")
def broken_path(tmp_path_factory):
    return tmp_path_factory.mktemp("broken") / "broken.mcap"


def read_all(path):
    """Read all parts of a recording; return the steps."""
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
    # A record begins with its opcode, 1 byte, and its length, 8 bytes, little endian.
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
    """Return a recording that contains only the description of a run."""
    put_together(path, about, [])
    return RecordedRun(path)


def test_a_recording_of_the_future(broken_path, about):
    with raises(RecordingError, names="format", value="9", allowed=FORMAT):
        described(broken_path, {**about, "format": "9"})


@pytest.mark.parametrize("key", ["profile", "settings", "versions", "started_unix_ns", "digest"])
def test_a_changed_description_is_refused(broken_path, recording, about, key):
    """The digest detects the change of a single digit."""
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


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    st.run(
        "text:on and on and on", "simulated:", mode="natural", seconds=2,
        listeners=[st.Recorder(path)],
    )  # fmt: skip
    return path


def test_its_arrays_are_those_of_its_steps(recorded):
    run, steps = st.load_recording(recorded), [*RecordedRun(recorded).steps()]
    arrays = run.arrays
    assert arrays is run.arrays
    assert len(arrays.step) == len(steps) > 50
    last = arrays.time_ns[-1] / 1e9
    assert last < run.seconds <= last + arrays.period_us[-1] / 1e6
    assert run.profile.name == "electric-mouse"
    assert run.settings["mode"] == "natural"
    assert run.whole
    assert [words for _, words in run.events]
    for index, each in enumerate(steps):
        own, sequence = slice(*arrays.first_slot[index : index + 2]), each.step.sequence
        np.testing.assert_array_equal(arrays.current_ua[own], sequence.current_ua)
        np.testing.assert_array_equal(arrays.width_us[own], sequence.width_us)
        np.testing.assert_array_equal(arrays.activation[index], each.step.tactile.activation)
        assert arrays.force_n[index] == each.step.input.force_n
        assert arrays.time_ns[index] == each.step.input.time_ns
        assert arrays.intensity[index] == sequence.intensity
        assert arrays.mode[index] == "natural"


PAGE = Path(__file__).parents[2] / "docs/reference/recordings.md"


def test_the_page_describes_each_array(golden):
    arrays = vars(st.load_recording(golden("regulated")).arrays)
    rows = re.findall(r"^\| `(\w+)` \| \(([^)]*)\) (\w+) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert {name for name, _, _ in rows} == arrays.keys()
    sizes = {
        "N": len(arrays["step"]), "N+1": len(arrays["step"]) + 1, "S": len(arrays["site"]),
        "E": 64, "3": 3,
    }  # fmt: skip
    for name, shape, kind in rows:
        sides = [side for side in shape.replace(" ", "").split(",") if side]
        assert arrays[name].shape == tuple(sizes[side] for side in sides)
        assert ("str" if arrays[name].dtype.kind == "U" else arrays[name].dtype.name) == kind


def through(steps):
    """Return steps after encoding to messages and decoding."""
    decoder, found = StepDecoder(steps[0].step.sequence.electrodes), []
    for index, sent in enumerate(steps):
        image = sent.step.input.image
        messages = [("/step", step_message(replace(sent, acknowledged=index)))]
        if image is not None:
            messages.insert(0, ("/frame", image_message(image, 10**18)))
        for topic, message in messages:
            data = json.dumps(message, allow_nan=False).encode()
            step = decoder.take(topic, index, data, sent.step.input.time_ns)
            found += [] if step is None else [step]
    assert decoder.broken == 0
    return found


def same(one, other):
    """Return whether two values are identical in all nested parts; NaN equals NaN."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, float) and math.isnan(one):
        return math.isnan(other)
    if isinstance(one, dict):
        # Recordings do not store ``sums``, because the currents contain the same information.
        return all(same(one[key], other[key]) for key in one if key != "sums")
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


@pytest.fixture(scope="module")
def sent(profile, steps):
    """Return steps with shared slots, recharge, voltages, vibration or unknown force."""
    results = []
    st.run("text:on", "simulated:", mode="natural", balance=True, seconds=1.5,
           listeners=[results.append])  # fmt: skip
    pipeline = Pipeline(profile, load_bank(profile), RunConfig(mode="COLOR"), vibrated=True)
    activation, image = np.eye(3, 64, 5, np.float32), np.full((4, 4), 9, np.uint8)
    for number, seen in enumerate((None, image, image)):
        given = Stimulus(activation, number * 10**9, 1.0, 20_000, 0.7, image=seen, number=number)
        results.append(StepResult(pipeline.process(given), None, 0.0))
    step, unknown = steps[0].step, {"force_n": math.nan, "pose": Pose(math.nan, -1e308, 1e-308)}
    blind = replace(
        step, input=replace(step.input, stale=True, **unknown),
        tactile=replace(step.tactile, force_n=math.nan),
    )  # fmt: skip
    results.append(replace(steps[0], step=blind))
    return results


def test_a_step_comes_back_to_the_bit(sent):
    found = through(sent)
    assert len(found) == len(sent)
    for index, (was, now) in enumerate(zip(sent, found, strict=True)):
        assert now.index == index
        assert type(was.step.input) is type(now.step.input)
        assert same(asdict(replace(was, acknowledged=index)), asdict(now.sent))
    sequences = [each.sequence for each in sent]
    assert any(each.recharge_us for each in sequences)
    assert any(each.proof is not None and each.points > each.slots for each in sequences)
    assert any(each.vibration is not None for each in sequences)
    assert any(each.step.observed for each in sent)


@pytest.mark.parametrize("force", [math.inf, -math.inf])
def test_an_endless_force_is_the_largest_there_is(steps, force):
    step = steps[0].step
    frame = Frame(step.input.image, 0, step.input.pose, force)
    endless = Step(frame, step.tactile, step.sequence, step.mode)
    (found,) = through([StepResult(endless, 1, 0.0)])
    assert math.isfinite(found.step.input.force_n)
    assert math.copysign(1e308, force) / found.step.input.force_n > 0.5


def test_foxglove_finds_what_the_schemas_name(steps):
    """The expected fields are those of ``schemas/jsonschema`` in foxglove-sdk."""
    messages = {
        "/frame": image_message(steps[0].step.input.image, 5),
        "/step": step_message(steps[0]),
        "/event": event_message("paused", 5),
    }
    assert set(messages) == set(SCHEMAS)
    for topic, message in messages.items():
        assert set(SCHEMAS[topic][1]) <= set(message)
    assert set(messages["/frame"]) == {"timestamp", "frame_id", "data", "format"}
    assert set(messages["/event"]) == {"timestamp", "level", "message", "name", "file", "line"}
    assert messages["/event"]["timestamp"] == {"sec": 0, "nsec": 5}


LAYOUT = Path(__file__).parents[2] / "docs" / "how-to" / "foxglove-layout.json"


def test_the_layout_names_what_there_is():
    layout = json.loads(LAYOUT.read_text("utf-8"))
    paths = []
    for panel in layout["configById"].values():
        paths += [panel["imageMode"]["imageTopic"]] if "imageMode" in panel else []
        paths += [panel["topicToRender"]] if "topicToRender" in panel else []
        paths += [path["value"] for path in panel.get("paths", ())]
    assert len(paths) == 6
    for path in paths:
        topic, _, key = path.partition(".")
        assert topic in SCHEMAS
        assert not key or key in SCHEMAS[topic][1]

    def panels(part):
        if isinstance(part, str):
            return [part]
        return [*panels(part["first"]), *panels(part["second"])]

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
