"""The loop of a run, from a source to a board, in time that passes by itself."""

from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.running.listener import as_listeners
from smarttouch.running.loop import run_loop
from smarttouch.running.run_statistics import RunStatistics


def loop_through(source, pipeline, board, *listeners, **options):
    """Deliver all that a source gives; return the statistics. Functions are called with steps."""
    usual = {"stop": StopRequest(), "statistics": RunStatistics(), "clock": SimulatedClock()}
    options = usual | options
    run_loop(source, pipeline, board, listeners=as_listeners(listeners), **options)
    return options["statistics"]
