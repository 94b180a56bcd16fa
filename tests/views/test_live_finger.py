"""A finger simulated during a run: the loop never waits for it, and the newest step wins."""

import os
import signal

import numpy as np
import pytest

import smarttouch as st
from smarttouch.views.live_finger import LiveFinger

from ..raising import raises


@pytest.fixture(scope="module")
def finger():
    return st.Finger(st.load_profile("electric-mouse"), seed=1, anatomy="paper")


def run(profile, *listeners, speed_mm_s=60):
    """Run on a board whose clock is set by the loop: only waiting takes time."""
    source = st.open_source("text:on", profile, speed_mm_s=speed_mm_s)
    return st.run(source, st.open_display("simulated:", profile), listeners=listeners)


class Stopped(st.Listener):
    """Stops the process of a finger before the first step, and lets it go on after the last."""

    def __init__(self, live):
        super().__init__()
        self.live, self.steps = live, []

    def start(self, run):
        os.kill(self.live._process.pid, signal.SIGSTOP)

    def step(self, result):
        self.steps.append(result)

    def finish(self, run):
        # All steps are over, and the finger is still at the first.
        assert self.live.simulated == 0
        os.kill(self.live._process.pid, signal.SIGCONT)


def test_the_loop_never_waits_for_a_finger_that_stands_still(finger):
    live = LiveFinger(finger)
    stopped = Stopped(live)
    statistics = run(finger.profile, stopped, live)
    assert statistics.frames == len(stopped.steps) > 20
    assert statistics.figures["period_error_us"]["max"] == 0
    assert (live.simulated, live.skipped) == (1, len(stopped.steps) - 1)
    np.testing.assert_array_equal(live.newest.counts, finger.feel(stopped.steps[0]).counts)


def test_the_newest_is_felt_next(finger):
    """Whenever the finger is done, it is given the step that has just come."""

    class Waits(st.Listener):
        """Holds each third step until the finger has felt the one it is at."""

        taken = []  # noqa: RUF012

        def step(self, result):
            if len(self.taken) % 3 == 0:
                assert live._line.poll(60)
            self.taken.append((live.simulated, result))

    live = LiveFinger(finger)
    # In this order: the finger has the step before.
    run(finger.profile, live, Waits(), speed_mm_s=150)
    assert len(Waits.taken) > 9
    assert live.simulated + live.skipped == len(Waits.taken)
    assert live.simulated >= len(Waits.taken) // 3
    last = max(number for number, _ in Waits.taken)
    given = next(result for number, result in Waits.taken if number == last)
    np.testing.assert_array_equal(live.newest.counts, finger.feel(given).counts)


def test_a_process_that_has_ended_ends_the_run(finger):
    live = LiveFinger(finger)

    class Kills(st.Listener):
        def start(self, run):
            live._process.kill()
            live._process.wait()

    with raises(st.SmartTouchError, names="finger"):
        run(finger.profile, Kills(), live)
