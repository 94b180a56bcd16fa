"""Recordings of stimuli: where there is nothing to see there is no image, and all else works."""

import json
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.instruments.color_mix import ColorSource, mix_colors
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.running.config import RunConfig
from smarttouch.running.display import open_display
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recorded_source import open_recording
from smarttouch.running.recorder import Recorder
from smarttouch.running.recording import RecordedRun
from smarttouch.running.recording_format import StepDecoder, image_message, step_message
from smarttouch.running.runner import Runner
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus


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
        decoder.take("/frame", 0, json.dumps(image_message(step.input.image, 0)).encode())
    message = step_message(StepResult(step, 1, 0.0)) | changed
    found = decoder.take("/step", 0, json.dumps(message).encode())
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
