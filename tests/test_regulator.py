"""What the board measured reaches the recording, and what is sent next."""

import numpy as np
import pytest

from smarttouch.pipeline import Pipeline
from smarttouch.regulator import Regulator
from smarttouch.scan.adaptation import Adaptation


class Told:
    """A board that tells what a test wants."""

    def __init__(self, *measured):
        self.measured = list(measured)

    def take_volts(self):
        taken, self.measured = self.measured, []
        return taken


@pytest.fixture
def step(profile, bank, make_frame, patch):
    pipeline = Pipeline(profile, bank)
    pipeline.process(make_frame(patch(), 0))
    return pipeline.process(make_frame(patch(), 10**9))


def measured(step, volts):
    return step.sequence, np.full(step.sequence.slots, volts, np.float32)


def test_what_was_measured_is_kept_with_the_step_it_came_before(step):
    first, second = measured(step, 80), measured(step, 90)
    board = Told(first, second)
    assert Regulator().regulate(step, board).observed == (first, second)
    assert Regulator().regulate(step, board) is step


def test_what_was_measured_changes_what_is_sent(profile, step):
    regulator = Regulator(Adaptation(profile, "energy", 300.0))
    before = regulator.regulate(step, Told(measured(step, 50))).sequence
    after = regulator.regulate(step, Told(measured(step, 100))).sequence
    # Twice the impedance: less by its square root.
    peaks = [np.abs(each.current_ua.astype(int)).max() for each in (before, after)]
    assert peaks[1] == pytest.approx(peaks[0] / np.sqrt(2), rel=0.01)
