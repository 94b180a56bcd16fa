"""The loop of a run, from a source to a board, in time that passes by itself."""

from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.running.loop import Loop
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import as_listeners


def loop_through(source, pipeline, board, *listeners, **options):
    """Deliver all that a source gives; return the statistics. Functions are called with steps."""
    usual = {"stop": StopRequest(), "statistics": RunStatistics(), "clock": SimulatedClock()}
    options = usual | options
    Loop(source, pipeline, board, listeners=as_listeners(listeners), **options).run()
    return options["statistics"]
