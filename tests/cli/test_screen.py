"""Words of the screen on shared slots."""

import re
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.afferent import Afferent
from smarttouch.monitor.screen import _ArrayLayout, _beside, _given
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.step import StepResult
from smarttouch.sources.stimulus import Stimulus
from smarttouch.stimulation.sharing import NO_SHARING, SlotPolicy


@pytest.fixture(params=[NO_SHARING, SlotPolicy((Afferent.RA,), planned=False)])
def sent(request, make_frame, profile, bank):
    image = np.full((64, 64), 255, np.uint8)
    image[20:44, 20:44] = 0
    pipeline = Pipeline(profile, bank, RunConfig(scan=request.param))
    pipeline.process(make_frame(image, 10**9))
    return StepResult(pipeline.process(make_frame(image, 2 * 10**9)), 1, 0.0)


def test_every_point_that_is_stimulated_is_shown(sent):
    points = np.flatnonzero(sent.step.tactile.activation.any(axis=0))
    felt_ma = sent.felt_ma
    assert len(points) >= 9
    assert sent.step.sequence.points == len(points)
    assert np.flatnonzero(felt_ma).tolist() == points.tolist()
    assert felt_ma[points].min() > 1


def test_what_shared_slots_do_is_told(sent):
    sequence = sent.step.sequence
    if sequence.proof is None:
        assert sequence.slots == sequence.points
        assert not re.search(r"\d", _beside(None))
        return
    assert sequence.slots < sequence.points
    other, spill = sequence.proof.shared
    assert re.findall(r"\d\.\d+", _beside(sequence.proof.shared)) == [
        f"{other:.2f}",
        f"{spill:.2f}",
    ]


def test_where_there_is_no_image_the_activation_is_drawn(profile, bank):
    activation = np.zeros((3, 64), np.float32)
    activation[Afferent.RA, [9, 27]] = 1, 0.5
    pipeline = Pipeline(profile, bank, RunConfig())
    step = pipeline.process(Stimulus(activation, 0, 1.0, 20_000))
    shown = str(_given(StepResult(step, 1, 0.0), _ArrayLayout(profile)))
    assert shown.count("·") == 62
    with_image = replace(step, input=replace(step.input, image=np.zeros((8, 8), np.uint8)))
    assert "▀" in str(_given(StepResult(with_image, 1, 0.0), _ArrayLayout(profile)))
