"""Real-time priority: raised within a block, if the user is allowed to, and then restored."""

import os
import subprocess
import sys
import threading

import pytest

from smarttouch.base.posix import PRIORITY, prioritized


def is_prioritized():
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


def in_a_thread(work):
    """Run ``work`` in a new thread, whose priority no test has changed. Return its result."""
    found = []
    thread = threading.Thread(target=lambda: found.append(work()))
    thread.start()
    thread.join()
    return found[0]


def test_it_is_for_one_thread_in_one_block():
    def policies():
        found = [is_prioritized()]
        with prioritized() as allowed:
            if not allowed:
                return None
            found += [is_prioritized(), os.sched_getparam(0).sched_priority == PRIORITY]
            command = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]
            child = subprocess.check_output(command)
            found += [in_a_thread(is_prioritized), int(child) != os.SCHED_OTHER]
        return [*found, is_prioritized()]

    found = in_a_thread(policies)
    if found is None:
        pytest.skip("no real-time priority for this user")
    assert found == [False, True, True, False, False, False]
