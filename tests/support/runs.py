"""The loop of a run in simulated time, and waiting for what another thread or process does."""

import time

from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.running.loop import Controls, ControlState, Loop
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import as_listeners


def loop_through(source, pipeline, board, *listeners, **options):
    """Deliver all that a source gives; return the statistics. Functions are called with steps."""
    usual = {"stop": StopRequest(), "statistics": RunStatistics(), "clock": SimulatedClock(),
             "controls": Controls(ControlState(pipeline.mode))}  # fmt: skip
    options = usual | options
    Loop(source, pipeline, board, listeners=as_listeners(listeners), **options).run()
    return options["statistics"]


HANGS_S = 60.0
"""Only what never comes takes that long."""


def until(holds):
    """Wait until something holds; return what it gives."""
    deadline_s = time.monotonic() + HANGS_S
    while not (found := holds()):
        assert time.monotonic() < deadline_s, "it never came true"
        time.sleep(0.002)
    return found


def undisturbed(attempt):
    """Return what an attempt gives besides a run's statistics, once nothing was late in that run.

    After a delay of the computer a run rises again: what it does in between is asked elsewhere.
    """

    def on_time():
        statistics, *found = attempt()
        figures = statistics.figures
        late = sum(figures[name] for name in ("late_frames", "dropped_late", "restarts"))
        return None if late else found

    return until(on_time)
