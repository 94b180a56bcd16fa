"""Runs on a board of simulated time: as fast as they can, or paced by the wall clock."""

import time

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.stopping import StopRequest
from smarttouch.running.check_recording import check_recording
from smarttouch.running.runner import Runner


def run(paced, *, url="text:touch what a sensor sees", stop=None, listeners=(), **settings):
    """Return the sequences of a run, its statistics, and the seconds that it took."""
    sequences = []
    profile = st.load_profile("smarttouch-4x4")
    runner = Runner(
        st.open_source(url, profile), st.open_display("simulated:", profile),
        st.RunConfig(paced=paced, **settings), stop=stop,
        listeners=[lambda result: sequences.append(result.sequence), *listeners],
    )  # fmt: skip
    begun_s = time.monotonic()
    statistics = runner.run()
    return sequences, statistics, time.monotonic() - begun_s


def test_a_paced_run_delivers_the_same_and_takes_its_time():
    fast, fast_statistics, _ = run(False, seconds=1)
    paced, statistics, took_s = run(True, seconds=1)
    assert took_s > 0.9
    # At the end of its seconds a slow computer has sent fewer.
    assert 10 < len(paced) <= len(fast) + 1
    for one, other in zip(fast, paced, strict=False):
        assert one.time_ns == other.time_ns
        assert np.array_equal(one.current_ua, other.current_ua)
    for each in (fast_statistics, statistics):
        assert each.restarts == 0
        assert each.figures["dropped_late"] == each.figures["refused"] == 0
        assert each.figures["emulator_violations"] == 0
        # When a simulated pulse comes says nothing about a finger.
        assert each.figures["motion_to_pulse_us"] is None


def test_a_computer_that_stalls_makes_nothing_late_on_the_board():
    def stall(result):
        if result.number == 10:
            time.sleep(0.25)

    sequences, statistics, _ = run(True, seconds=1.5, listeners=[stall])
    assert statistics.late >= 1
    assert statistics.restarts == statistics.figures["dropped_late"] == 0
    # Nor does intensity begin at zero again.
    levels = [each.intensity for each in sequences]
    assert levels == sorted(levels)
    assert levels[10] > levels[5] > 0


@pytest.mark.parametrize("at_once", [True, False])
def test_a_stop_ends_a_paced_run_within_a_moment(at_once):
    stop, asked_s = StopRequest(), []

    def ask(result):
        if result.number == 5:
            asked_s.append(time.monotonic())
            stop.ask("the test", at_once=at_once)

    sequences, statistics, _ = run(True, stop=stop, listeners=[ask])
    assert statistics.ended == "the test"
    assert time.monotonic() - asked_s[0] < 2
    assert len(sequences) == 5


def test_the_machine_paces_a_board_with_time_of_its_own_anyway():
    begun_s = time.monotonic()
    st.run("text:a", "memory:", seconds=0.3)
    assert time.monotonic() - begun_s > 0.25


def test_a_recording_of_a_paced_run_is_as_exact(tmp_path):
    path = tmp_path / "run.mcap"
    run(True, seconds=0.2, listeners=[st.Recorder(path)])
    assert "paced" not in st.load_recording(path).settings
    assert check_recording(path).exact


def test_a_paced_session_keeps_real_time():
    dot = np.eye(64, dtype=np.float32)[27]
    with st.open_display("simulated:").session(mode="RA", intensity=0.6, paced=True) as touch:
        touch.rise()
        begun_s = time.monotonic()
        shown = touch.show(dot, 0.3)
        touch.wait(0.2)
        assert time.monotonic() - begun_s > 0.45
        assert (shown.sequences, shown.intensity) == (15, 0.6)
        touch.put(dot, stale_s=0.2)
        time.sleep(0.5)
    assert touch.statistics.seconds > 0.5
    assert touch.statistics.figures["emulator_violations"] == 0
