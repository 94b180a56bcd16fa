"""Helpers that run the loop in simulated time, and that wait for threads and processes."""

import time

from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.running.loop import Controls, ControlState, Loop
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step_records import as_listeners


def loop_through(source, pipeline, board, *listeners, **options):
    """Run the loop until the source ends; return its statistics. Listeners can be functions."""
    usual = {"stop": StopRequest(), "statistics": RunStatistics(), "clock": SimulatedClock(),
             "controls": Controls(ControlState(pipeline.mode))}  # fmt: skip
    options = usual | options
    Loop(source, pipeline, board, listeners=as_listeners(listeners), **options).run()
    return options["statistics"]


HANGS_S = 60.0
"""Timeout of tests: only a hang takes longer, even on a busy computer."""


def until(holds):
    """Call ``holds`` repeatedly until its result is true; return this result."""
    deadline_s = time.monotonic() + HANGS_S
    while not (found := holds()):
        assert time.monotonic() < deadline_s, f"no success within {HANGS_S:g} s"
        time.sleep(0.002)
    return found


def undisturbed(attempt):
    """Repeat an attempt until no sequence is late; return its results without the statistics.

    A late sequence restarts the ramp, which changes the results. Other tests cover restarts.
    """

    def on_time():
        statistics, *found = attempt()
        figures = statistics.figures
        late = sum(figures[name] for name in ("late_frames", "dropped_late", "restarts"))
        return None if late else found

    return until(on_time)
