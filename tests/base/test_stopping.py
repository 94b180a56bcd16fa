"""A stop request calls all functions that were added for it, in order."""

import threading

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.base.stopping import StopRequest

PATIENCE_S = 20


def test_functions_are_called_at_once_and_only_within_their_block():
    stop, told = StopRequest(), []
    with stop.on_stop(lambda: told.append("within")):
        stop.ask("key q")
        assert told == ["within"]
        with stop.on_stop(lambda: told.append("asked before")):
            pass
    stop.ask("key Esc")
    assert told == ["within", "asked before"]
    assert (stop.reason, stop.event.is_set()) == ("key q", True)


def test_an_end_that_can_wait_calls_nothing():
    stop, told = StopRequest(), []
    with stop.on_stop(lambda: told.append(1)):
        stop.ask("5 s are over", at_once=False)
    assert (told, stop.event.is_set()) == ([], True)


def test_one_that_fails_does_not_keep_others_from_being_called():
    stop, told = StopRequest(), []

    def fails():
        raise BoardError("the line broke")

    with stop.on_stop(fails), stop.on_stop(lambda: told.append(1)):
        stop.ask("key q")
    assert told == [1]


def test_one_that_fails_in_any_way_is_raised_once_all_were_called():
    """All functions are called before an error is raised, so that the other boards stop, too."""
    stop, told = StopRequest(), []
    with stop.on_stop(lambda: told.append(1)), stop.on_stop(lambda: 1 / 0):
        with pytest.raises(ZeroDivisionError):
            stop.ask("key q")
        assert told == [1]


def test_one_that_is_entered_while_the_end_is_requested_is_called():
    stop, told, over = StopRequest(), [], threading.Event()

    def enter():
        with stop.on_stop(lambda: told.append(1)):
            over.wait(PATIENCE_S)

    class Slow(threading.Event):
        def set(self):
            entering.start()
            entering.join(0.1)
            super().set()

    entering, stop.event = threading.Thread(target=enter, daemon=True), Slow()
    stop.ask("key q")
    over.set()
    entering.join(PATIENCE_S)
    assert told == [1]
