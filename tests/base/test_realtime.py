"""Real-time priority is taken where it is allowed, and given back."""

import os
import subprocess
import sys
import threading

import pytest

from smarttouch.base.posix import PRIORITY, prioritized


def is_prioritized():
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


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
