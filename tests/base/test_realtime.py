"""Real-time priority is taken where it is allowed, and given back."""

import os
import subprocess
import sys
import threading

import pytest

from smarttouch.base import clock, posix
from smarttouch.base.clock import SPIN_NS, MonotonicClock
from smarttouch.base.posix import PRIORITY, is_prioritized, prioritized


def in_a_thread(work):
    """Return what a fresh thread finds: one whose priority no test has changed."""
    found = []
    thread = threading.Thread(target=lambda: found.append(work()))
    thread.start()
    thread.join()
    return found[0]


def allowed():
    def has_it():
        with prioritized() as given:
            return given

    return in_a_thread(has_it)


needs_priority = pytest.mark.skipif(not allowed(), reason="no real-time priority for this user")


@needs_priority
def test_it_is_given_and_given_back():
    def policies():
        found = [is_prioritized()]
        with prioritized() as given:
            found += [given, is_prioritized(), os.sched_getparam(0).sched_priority == PRIORITY]
        return [*found, is_prioritized()]

    assert in_a_thread(policies) == [False, True, True, True, False]


@needs_priority
def test_what_begins_meanwhile_is_as_usual():
    def begun():
        with prioritized():
            command = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]
            child = subprocess.run(command, capture_output=True, check=True)
            return in_a_thread(is_prioritized), int(child.stdout)

    assert in_a_thread(begun) == (False, os.SCHED_OTHER)


def refuse(*_):
    raise PermissionError


def test_where_it_is_not_allowed_work_goes_on(monkeypatch):
    monkeypatch.setattr(os, "sched_setscheduler", refuse)

    def work():
        with prioritized() as allowed:
            return allowed, is_prioritized()

    assert in_a_thread(work) == (False, False)


def test_on_systems_without_it_work_goes_on(monkeypatch):
    monkeypatch.setattr(posix, "_FIFO", None)
    with prioritized() as given:
        assert not given
        assert not is_prioritized()


class Event:
    """Keeps how long it was waited for."""

    waited_s = None

    def wait(self, timeout_s):
        self.waited_s = timeout_s
        return True

    def is_set(self):
        return False


@pytest.mark.parametrize(("spin_ns", "real_time", "spun_ns"), [
    (None, False, 0), (None, True, SPIN_NS), (0, True, 0), (2_000_000, False, 2_000_000),
])  # fmt: skip
def test_only_where_it_has_priority_a_wait_is_spun(monkeypatch, spin_ns, real_time, spun_ns):
    monkeypatch.setattr(clock, "is_prioritized", lambda: real_time)
    machine, event = MonotonicClock(spin_ns), Event()
    monkeypatch.setattr(machine, "now_ns", lambda: 1_000_000)
    machine.wait_until(11_000_000, event)
    assert event.waited_s == pytest.approx((10_000_000 - spun_ns) / 1e9)
