"""Steps come out of messages as they went in, to the bit."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from smarttouch.base.afferent import Mode
from smarttouch.base.tactile_image import TactileImage
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.recording_format import LAST, TOPICS, schema
from smarttouch.running.step import Step, StepResult
from smarttouch.running.step_decoder import StepDecoder
from smarttouch.running.step_encoder import StepEncoder
from smarttouch.sources.source_contract import Frame, Pose, Stimulus
from smarttouch.stimulation.scan_sequence import ScanSequence, SelectivityReport

numbers = st.floats(allow_infinity=False)
whole_us = st.integers(0, 65535)


@st.composite
def sequences(draw, time_ns, electrodes):
    slots = draw(st.integers(0, 4))

    def column():
        return draw(arrays.arrays(np.uint16, slots, elements=whole_us))

    recharge_us = draw(st.integers(0, 20_000))
    recharge = draw(arrays.arrays(np.int16, electrodes)) if recharge_us else None
    return ScanSequence(
        draw(arrays.arrays(np.int16, (slots, electrodes))),
        column(),
        column(),
        column(),
        draw(st.integers(1, 10**6)),
        draw(st.floats(0, 1)),
        time_ns,
        draw(st.none() | arrays.arrays(np.float32, electrodes, elements=st.floats(0, 1, width=32))),
        draw(st.none() | proofs(slots)),
        recharge,
        recharge_us,
    )


def proofs(slots):
    ratio = st.floats(0, width=32, allow_infinity=False) | st.just(math.nan)
    ratios = arrays.arrays(np.float32, slots, elements=ratio)
    return st.builds(
        SelectivityReport, arrays.arrays(np.uint16, slots, elements=whole_us), ratios, ratios
    )


@st.composite
def runs(draw):
    """Steps, some with the image of the one before, and voltages of what was before them."""
    electrodes, made, image, number = draw(st.integers(1, 5)), [], None, 0
    for index in range(draw(st.integers(1, 4))):
        if image is None or draw(st.booleans()):
            image = draw(arrays.arrays(np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 6))))
            number += 1
        time_ns = index * 10**7 + draw(st.integers(0, 10**6))
        observed = tuple(
            (each.step.sequence, draw(arrays.arrays(np.float32, each.step.sequence.slots)))
            for each in made[-1:]
        )
        activation = draw(
            arrays.arrays(np.float32, (3, electrodes), elements=st.floats(0, 1, width=32))
        )
        force_n = draw(numbers)
        rest = {
            "pose": Pose(*(draw(numbers) for _ in range(3))),
            "number": number,
            "age_ns": draw(st.integers(0, 10**9)),
            "stale": draw(st.booleans()),
        }
        if draw(st.booleans()):
            period_us, level = draw(st.integers(0, 10**6)), draw(st.floats(0, 1))
            seen = draw(st.sampled_from([None, image]))
            given = tactile = Stimulus(
                activation, time_ns, force_n, period_us, level, image=seen, **rest
            )
        else:
            given = Frame(image, time_ns, force_n=force_n, **rest)
            tactile = TactileImage(activation, time_ns, force_n)
        step = Step(
            input=given, tactile=tactile, sequence=draw(sequences(time_ns, electrodes)),
            mode=draw(st.sampled_from(Mode)), level=draw(st.floats(0, 1)),
            restarted=draw(st.booleans()), asked_us=draw(st.integers(0, 10**6)), observed=observed,
        )  # fmt: skip
        made.append(
            StepResult(step, draw(st.none() | st.integers(0, 2**32)), draw(st.floats(0, 1e9)))
        )
    return made


def through(steps):
    """Return steps as they come back from their messages."""
    decoder = StepDecoder(steps[0].step.sequence.electrodes)
    encoder, found = StepEncoder(10**18), []
    for index, sent in enumerate(steps):
        for topic, message in encoder.messages(replace(sent, acknowledged=index)):
            step = decoder.take(topic, index, json.dumps(message, allow_nan=False).encode())
            found += [] if step is None else [step]
    assert decoder.broken == 0
    return found


def same(one, other):
    """Tell whether two things have the same bits, in all their parts."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, float) and math.isnan(one):
        return math.isnan(other)
    if isinstance(one, dict):
        return all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other


@given(runs())
def test_a_step_comes_back_to_the_bit(steps):
    found = through(steps)
    assert len(found) == len(steps)
    for index, (was, now) in enumerate(zip(steps, found, strict=True)):
        assert (now.index, now.acknowledged, now.refused) == (index, index, 0)
        one, other = asdict(was), asdict(now.sent)
        assert type(was.step.input) is type(now.step.input)
        tactile = [each["step"]["tactile"].pop("activation") for each in (one, other)]
        assert same(one, other)
        # What was asked for cannot be computed again: it has to come back exactly.
        np.testing.assert_allclose(*tactile, atol=5.1e-5 * isinstance(was.step.input, Frame))


def test_an_endless_ratio_is_the_largest_there_is(steps):
    sent, endless = steps[0], np.full(1, np.inf, np.float32)
    sequence = replace(
        sent.step.sequence,
        **{key: np.ones(1, np.uint16) for key in ("width_us", "discharge_us", "site")},
        current_ua=np.zeros((1, 64), np.int16),
        proof=SelectivityReport(np.ones(1, np.uint16), endless, endless),
    )
    [found] = through([replace(sent, step=replace(sent.step, sequence=sequence))])
    assert found.sent.step.sequence.proof.off_target[0] == np.finfo(np.float32).max


def test_an_image_is_written_once(steps):
    encoder = StepEncoder(0)
    topics = [topic for sent in steps[:6] for topic, _ in encoder.messages(sent)]
    assert topics.count("/frame") == 3
    assert topics.count(LAST) == 6


def test_another_image_of_the_same_number_is_not_lost(make_frame, profile, bank):
    """A sensor that numbers its images wrongly is recorded as it was."""
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"))
    images = [np.full((64, 64), grey, np.uint8) for grey in (10, 10, 200)]
    steps = [
        StepResult(pipeline.process(make_frame(image, k)), k, 0.0) for k, image in enumerate(images)
    ]
    assert [each.step.input.image[0, 0] for each in through(steps)] == [10, 10, 200]


@pytest.mark.parametrize("force", [math.inf, -math.inf])
def test_an_endless_force_is_the_largest_there_is(steps, force):
    step = steps[0].step
    frame = Frame(step.input.image, 0, step.input.pose, force)
    endless = Step(frame, step.tactile, step.sequence, step.mode)
    (found,) = through([StepResult(endless, 1, 0.0)])
    assert math.isfinite(found.step.input.force_n)
    assert math.copysign(1e308, force) / found.step.input.force_n > 0.5


def test_images_and_words_fit_foxglove(steps, with_volts):
    """By schemas/jsonschema of foxglove-sdk."""
    encoder = StepEncoder(123, load_profile("electric-mouse").electrodes)
    sent = with_volts(steps[30], (steps[30].step.sequence, np.ones(9)))
    stimulus = Stimulus(sent.step.tactile.activation, 0, 1.0, 20_000, image=sent.step.input.image)
    messages = dict(encoder.messages(replace(sent, step=replace(sent.step, input=stimulus))))
    messages["/event"] = encoder.event(5, "paused")
    assert messages.keys() == TOPICS.keys()
    image = {"timestamp", "frame_id", "data", "format"}
    for topic, name, required in (
        ("/frame", "foxglove.CompressedImage", image),
        ("/tactile_image", "foxglove.CompressedImage", image),
        ("/event", "foxglove.Log", {"timestamp", "level", "message", "name", "file", "line"}),
    ):
        assert TOPICS[topic][0] == schema(topic)["title"] == name
        assert messages[topic].keys() == schema(topic)["properties"].keys() == required
