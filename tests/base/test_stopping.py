"""A stop reaches everything it must, whatever the main thread is doing."""

import os
import signal
import threading
import time

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.base.stopping import RunStopped, SignalWatch, StopRequest, thread_states

from ..waiting import until

PATIENCE_S = 20


@pytest.fixture
def forced():
    """Numbers of the signals that ended the process by force."""
    return []


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
    """As `Board.halt` does by a fault of a driver, while other boards still drive."""
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


@pytest.mark.parametrize(("number", "name"), [
    (signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "SIGHUP"),
])  # fmt: skip
def test_a_signal_ends_in_order_and_then_by_force(forced, number, name):
    stop, told = StopRequest(), threading.Event()
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with SignalWatch(stop, forced.append) as watch, stop.on_stop(told.set):
        watch.patience_s = 0.0
        with watch.ending_in_order():
            os.kill(os.getpid(), number)
            assert stop.event.wait(PATIENCE_S)
            assert told.wait(PATIENCE_S)
    assert (stop.reason, watch.number) == (name, number)
    until(lambda: forced == [number])
    assert [
        signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    ] == before


def test_a_signal_before_there_is_anything_to_end_in_order_raises_once(forced):
    unwound = []

    def start():
        try:
            os.kill(os.getpid(), signal.SIGHUP)
        finally:
            # What it unwinds is not cut short by another.
            os.kill(os.getpid(), signal.SIGINT)
            unwound.append(True)

    with pytest.raises(RunStopped) as caught, SignalWatch(StopRequest(), forced.append):
        start()
    assert unwound == [True]
    assert caught.value.number == signal.SIGHUP
    until(lambda: forced == [signal.SIGHUP])


def test_a_signal_while_the_main_thread_holds_the_lock_that_is_waited_for(forced):
    """A handler that sets the event would wait for ever for the thread that it interrupts."""
    stop = StopRequest()
    with SignalWatch(stop, forced.append) as watch, watch.ending_in_order():
        with stop.event._cond:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.05)
            assert not stop.event.is_set()
        assert stop.event.wait(PATIENCE_S)


def test_a_board_that_is_not_at_zero_yet_is_waited_for(forced):
    stop, at_zero = StopRequest(), threading.Event()
    with SignalWatch(stop, forced.append) as watch, stop.on_stop(lambda: at_zero.wait(PATIENCE_S)):
        watch.patience_s = 0.0
        with watch.ending_in_order():
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.event.wait(PATIENCE_S)
            time.sleep(0.1)
            assert forced == []
            at_zero.set()
            until(lambda: forced == [signal.SIGTERM])


def test_without_a_signal_nothing_is_left_behind(forced):
    threads = threading.active_count()
    with SignalWatch(StopRequest(), forced.append):
        assert threading.active_count() == threads + 1
    assert threading.active_count() == threads
    assert forced == []


def test_a_working_and_a_waiting_thread_are_distinguished():
    over, numbers = threading.Event(), {}

    def work():
        numbers["work"] = threading.get_native_id()
        while not over.is_set():
            pass

    def wait():
        numbers["wait"] = threading.get_native_id()
        over.wait()

    threads = [threading.Thread(target=each, daemon=True) for each in (work, wait)]
    for thread in threads:
        thread.start()
    until(lambda: len(numbers) == 2)
    seen = set()

    def told_apart():
        states = dict(thread_states())
        seen.update((name, states[number]) for name, number in numbers.items())
        return {("work", "R"), ("wait", "S")} <= seen

    until(told_apart)
    over.set()
    for thread in threads:
        thread.join(PATIENCE_S)


def test_who_is_slow_is_waited_for_and_who_waits_is_not(monkeypatch, forced):
    states = [[(1, "R")]] * 3 + [[(1, "S")]] * 100
    looks = []

    def told():
        looks.append(states[len(looks)])
        return looks[-1]

    monkeypatch.setattr("smarttouch.base.stopping.thread_states", told)
    with SignalWatch(StopRequest(), forced.append) as watch:
        watch.patience_s = 0.0
        with watch.ending_in_order():
            os.kill(os.getpid(), signal.SIGTERM)
            until(lambda: forced == [signal.SIGTERM])
    assert looks[:4] == states[:4]
    assert len(looks) >= 8
