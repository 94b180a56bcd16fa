"""Tests of errors while a key is handled, and of signals to a command that blocks."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from smarttouch.views.keys_and_signals import LOST, keyboard_listener

PATIENCE_S = 20


@pytest.fixture
def terminal(monkeypatch):
    """Yield the keyboard end of a terminal that replaces standard input."""
    far, near = os.openpty()
    with os.fdopen(near) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield far
    os.close(far)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_key_that_fails_counts_as_a_lost_terminal(terminal):
    """After the key whose handler fails, no other key is read, not even q."""
    heard, lost = [], threading.Event()

    def on_key(key):
        heard.append(key)
        if key == LOST:
            lost.set()
        elif key == "x":
            raise ValueError(key)

    with keyboard_listener(on_key):
        os.write(terminal, b"axq")
        assert lost.wait(PATIENCE_S)
    assert heard == ["a", "x", LOST]


BLOCKS = """
import os, signal, time
from smarttouch.views.keys_and_signals import drives_a_board, ending_in_order
@drives_a_board
def block():
    with ending_in_order(0.1):
        os.kill(os.getpid(), signal.SIGTERM)
        while True:
            time.sleep(1)
block()
"""


def test_a_command_that_blocks_ends_by_a_signal_and_shows_the_cursor():
    far, near = os.openpty()
    os.set_blocking(far, False)
    with os.fdopen(near) as screen, os.fdopen(far, "rb", 0) as seen:
        done = subprocess.run(
            [sys.executable, "-c", BLOCKS], stdout=screen, timeout=PATIENCE_S, check=False
        )
        assert done.returncode == 128 + signal.SIGTERM
        assert b"\x1b[?25h" in (seen.read(100) or b"")
