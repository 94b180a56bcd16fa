"""A recording plays what was seen, and counts what it passes over."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import RecordingError, SourceError
from smarttouch.instruments.color_mix import ColorSource, mix_colors
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import open_display
from smarttouch.running.inputs import ControlState
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorded_source import RecordedControls, open_recording
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording import RecordedRun
from smarttouch.running.recording_format import StepDecoder, image_message, step_message
from smarttouch.running.runner import Runner
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus

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
    """So that nothing is felt of it, as when it was recorded."""
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
            # Frames go to any array.
            assert source.narrowed(profile).full_ma.max() <= profile.full_ma.max()
        else:
            assert source.narrowed(profile) is profile
            with raises(RecordingError, names="electrodes", value=64):
                source.narrowed(load_profile(other))


@pytest.fixture
def forge(golden, tmp_path):
    """Return a maker of recordings with changed messages."""

    def make(change):
        about, messages = take_apart(golden("ra"))
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


def test_where_steps_are_missing_there_is_no_current(forge, profile):
    # A step every 50 ms.
    path = forge(lambda messages: [each for each in messages if not 5 <= each[3] <= 12])
    with open_recording(str(path), profile) as source:
        stale = [source.read(time_ms * 10**6).stale for time_ms in (240, 345, 355, 640, 655)]
    assert stale == [False, False, True, True, False]


@pytest.fixture(scope="module")
def run(profile, bank, tmp_path_factory):
    """Record a run of stimuli; return the file and the results of its steps."""
    path, results = tmp_path_factory.mktemp("stimuli") / "run.mcap", []
    trace = open_trace("tone:30Hz,9um+press:0.45N", 0.8)
    mixture = mix_colors(trace, profile, bank, sites=[27, 36])
    source = ColorSource("a mixture", profile, mixture, profile.force.full_n)
    with open_display("simulated:", profile) as display:
        listeners = [Recorder(path), results.append]
        config = RunConfig(mode=mixture.mode)
        Runner(source, display, config, listeners=listeners, load_kernels=lambda _: bank).run()
    return path, results


def decoded(step, image=True, **changed):
    """Return a step from its messages, some values changed, with or without that of its image."""
    decoder = StepDecoder(64)
    if image and step.input.image is not None:
        decoder.take("/frame", 0, json.dumps(image_message(step.input.image, 0)).encode(), 0)
    message = step_message(StepResult(step, 1, 0.0)) | changed
    found = decoder.take("/step", 0, json.dumps(message).encode(), step.input.time_ns)
    assert decoder.broken == (found is None)
    return found


def test_they_are_played_once_more(run, profile):
    path, results = run
    assert "/frame" not in {topic for topic, _ in RecordedRun(path).messages()}
    assert len(results) > 30
    with open_recording(str(path), profile) as source:
        for sent in results:
            given = source.read(sent.input.time_ns)
            assert (given.number, given.period_us) == (sent.input.number, sent.input.period_us)
            assert np.array_equal(given.activation, sent.input.activation)
        last = results[-1]
        assert source.read(last.input.time_ns + 1000 * last.sequence.period_us) is None
    assert (source.frames, source.dropped_frames) == (len(results), 0)


@pytest.fixture(scope="module")
def touched(profile, bank):
    """Return a step of a stimulus with an image."""
    activation, image = np.zeros((3, 64), np.float32), np.full((4, 4), 9, np.uint8)
    activation[Afferent.RA, 5] = 0.25
    stimulus = Stimulus(activation, 0, 1.0, 20_000, image=image)
    return Pipeline(profile, bank, RunConfig(mode=Mode.RA)).process(stimulus)


def test_what_lay_under_the_finger_stays_with_its_stimulus(touched):
    assert np.array_equal(decoded(touched).step.input.image, touched.input.image)


def test_an_image_that_was_lost_is_not_passed_over(touched):
    assert decoded(touched, image=False) is None
    blind = replace(touched, input=replace(touched.input, image=None))
    assert decoded(blind).step.input.image is None
    # Without a stimulus there is nothing to be felt.
    assert decoded(blind, stimulus=False) is None


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


def test_a_level_above_the_strongest_comfortable_current_is_not_followed(golden, tmp_path):
    about, messages = take_apart(golden("ra"))
    for topic, content, _, _ in messages:
        if topic == "/step":
            content["level"] = 1.5
    put_together(tmp_path / "forged.mcap", about, messages)
    controls = RecordedControls(
        RecordedRun(tmp_path / "forged.mcap"), ControlState(Mode.RA, 0.2), tuple(Mode)
    )
    assert controls.state(10**9).level == 0.2
