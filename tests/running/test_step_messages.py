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
from smarttouch.running.recording_format import (
    SCHEMAS,
    StepDecoder,
    event_message,
    image_message,
    step_message,
)
from smarttouch.running.step import Step, StepResult
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
    decoder, found = StepDecoder(steps[0].step.sequence.electrodes), []
    for index, sent in enumerate(steps):
        image = sent.step.input.image
        messages = [("/step", step_message(replace(sent, acknowledged=index)))]
        if image is not None:
            messages.insert(0, ("/frame", image_message(image, 10**18)))
        for topic, message in messages:
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
        assert now.index == index
        assert type(was.step.input) is type(now.step.input)
        assert same(asdict(replace(was, acknowledged=index)), asdict(now.sent))


@pytest.mark.parametrize("force", [math.inf, -math.inf])
def test_an_endless_force_is_the_largest_there_is(steps, force):
    step = steps[0].step
    frame = Frame(step.input.image, 0, step.input.pose, force)
    endless = Step(frame, step.tactile, step.sequence, step.mode)
    (found,) = through([StepResult(endless, 1, 0.0)])
    assert math.isfinite(found.step.input.force_n)
    assert math.copysign(1e308, force) / found.step.input.force_n > 0.5


def test_foxglove_finds_what_the_schemas_name(steps):
    """By schemas/jsonschema of foxglove-sdk."""
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
