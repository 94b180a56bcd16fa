"""Tests of recordings as sources: inputs at their recorded times, and counts of dropped inputs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import RecordingError, SourceError
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.loop import ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorded_source import RecordedControls, open_recording
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.step_records import StepResult

from ..support.checks import raises
from .forged_recordings import put_together, take_apart


def test_at_the_recorded_times_all_comes_again(recording, steps, profile, bank):
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"))
    with open_recording(str(recording), profile) as source:
        assert source.knows_force
        assert source.duration_s == pytest.approx(0.78)
        for sent in steps:
            was = sent.step.input
            frame = source.read(was.time_ns)
            assert np.array_equal(frame.image, was.image)
            assert (frame.time_ns, frame.pose, frame.force_n) == (
                was.time_ns, was.pose, was.force_n,
            )  # fmt: skip
            again = pipeline.process(frame).sequence
            assert np.array_equal(again.current_ua, sent.step.sequence.current_ua)
        assert source.read(799_999_999).number == 19
        assert source.read(800_000_000) is None
    assert (source.frames, source.dropped_frames, source.notes) == (20, 0, [])


def test_stimuli_are_played_once_more(golden, profile):
    steps = [each.step for each in RecordedRun(golden("color")).steps()]
    with open_recording(str(golden("color")), profile) as source:
        for step in steps:
            given = source.read(step.input.time_ns)
            assert (given.number, given.period_us) == (step.input.number, step.input.period_us)
            assert np.array_equal(given.activation, step.input.activation)
            assert np.array_equal(given.image, step.input.image)
        assert source.read(step.input.time_ns + 1000 * step.sequence.period_us) is None


@settings(deadline=None)
@given(st.lists(st.integers(0, 9 * 10**8), max_size=12))
def test_every_frame_is_read_or_dropped(recording, profile, times):
    numbers = set()
    source = open_recording(str(recording), profile)
    for time_ns in sorted(times):
        frame = source.read(time_ns)
        if frame is not None:
            numbers.add(frame.number)
            assert frame.age_ns < 20_000_000
    source.close()
    assert source.frames == len(numbers) + source.dropped_frames
    if times and max(times) >= 8 * 10**8:
        assert source.frames == 20


def test_what_was_stale_stays_stale(tmp_path, record, steps, profile):
    """No current flows for a stale input, neither in the run nor in its replay."""
    step = steps[0].step
    stale = replace(step, input=replace(step.input, stale=True, force_n=0.0))
    path = record(tmp_path / "a.mcap", [StepResult(stale, 1, 0.0)])
    with open_recording(str(path), profile) as source:
        frame = source.read(0)
    assert (frame.stale, frame.force_n) == (True, 0.0)


def test_a_cut_one_is_played_as_far_as_it_goes(cut, profile):
    with open_recording(str(cut), profile) as source:
        assert source.read(0).number == 0
        (note,) = source.notes
        assert str(cut) in note


def test_what_cannot_be_played(tmp_path, record, profile):
    with raises(SourceError):
        open_recording("", profile)
    with raises(RecordingError, value=tmp_path / "none.mcap"):
        open_recording(str(tmp_path / "none.mcap"), profile)
    with raises(SourceError, value=tmp_path / "run.mcap"):
        open_recording(str(record(tmp_path / "run.mcap", [])), profile)


@pytest.mark.parametrize(("name", "other"), [("color", "kajimoto-61"), ("kajimoto", None)])
def test_on_a_finger_the_profile_is_narrowed_and_stimuli_stay_on_their_array(
    golden, profile, name, other
):
    with open_recording(str(golden(name)), profile) as source:
        if other is None:
            # Frames, unlike stimuli, can be shown on an array of another size.
            assert source.narrowed(profile).full_ma.max() <= profile.full_ma.max()
        else:
            assert source.narrowed(profile) is profile
            with raises(RecordingError, names="electrodes", value=64):
                source.narrowed(load_profile(other))


@pytest.fixture
def forge(golden, tmp_path):
    """Return a function that changes the messages of a golden recording."""

    def make(change, name="ra"):
        about, messages = take_apart(golden(name))
        put_together(path := tmp_path / "forged.mcap", about, change(messages))
        return path

    return make


@pytest.mark.parametrize(("topic", "key", "value"), [
    ("/step", "period_us", 0), ("/step", "period_us", 2**63), ("/step", "time_ns", 2**62),
])  # fmt: skip
def test_a_recording_does_not_wait_for_ever(forge, profile, topic, key, value):
    def change(messages):
        at = max(index for index, message in enumerate(messages) if message[0] == topic)
        messages[at][1][key] = value
        return messages

    path = forge(change)
    with open_recording(str(path), profile) as source:
        assert source.read(10**12) is None
    run = RecordedRun(path)
    assert list(run.steps())
    assert run.broken_steps == 1


@pytest.mark.parametrize("name", ["ra", "color"])
def test_a_step_whose_image_was_lost_is_not_passed_over(forge, name):
    run = RecordedRun(forge(lambda messages: [m for m in messages if m[0] != "/frame"], name))
    assert [*run.steps()] == []
    assert run.broken_steps >= 20


def test_where_steps_are_missing_there_is_no_current(forge, profile):
    # Steps are 50 ms apart: without steps 5 to 12, the input is unknown from 250 to 650 ms.
    path = forge(lambda messages: [each for each in messages if not 5 <= each[3] <= 12])
    with open_recording(str(path), profile) as source:
        stale = [source.read(time_ms * 10**6).stale for time_ms in (240, 345, 355, 640, 655)]
    assert stale == [False, False, True, True, False]


@pytest.fixture(params=["sai-levels", "natural"])
def wishes(request, golden):
    return RecordedRun(golden(request.param))


def test_every_wish_comes_at_its_time(wishes):
    controls = RecordedControls(wishes, ControlState(Mode.RA), tuple(Mode))
    steps = [recorded.step for recorded in wishes.steps()]
    assert len({(step.mode, step.level) for step in steps}) > 1
    for step in steps:
        wish = controls.state(step.input.time_ns)
        assert (wish.mode, wish.current_level) == (step.mode, step.level)


def test_today_s_user_lowers_and_pauses(wishes):
    controls = RecordedControls(wishes, ControlState(Mode.RA, 0.5), tuple(Mode))
    step = next(each.step for each in wishes.steps() if each.step.level > 0)
    assert controls.state(step.input.time_ns).current_level == 0.5 * step.level
    controls.toggle_pause()
    assert controls.state(step.input.time_ns).current_level == 0
    controls.toggle_pause()
    controls.next_mode()
    controls.choose_mode(Mode.SAI)
    assert controls.state(step.input.time_ns).mode is step.mode


def test_a_board_without_the_recorded_mode_is_refused(golden):
    with raises(RecordingError, names="mode", value="natural"):
        RecordedControls(RecordedRun(golden("natural")), ControlState(Mode.RA), (Mode.RA,))


def test_a_level_above_the_strongest_comfortable_current_is_not_followed(forge):
    def change(messages):
        return [(topic, {**content, "level": 1.5}, *rest) for topic, content, *rest in messages]

    controls = RecordedControls(RecordedRun(forge(change)), ControlState(Mode.RA, 0.2), tuple(Mode))
    assert controls.state(10**9).level == 0.2
