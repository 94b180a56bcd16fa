"""Keys of a terminal end a run, whatever other keys do."""

import os
import sys
import threading

import pytest

from smarttouch.views.keys_and_signals import LOST, keyboard_listener

PATIENCE_S = 20


@pytest.fixture
def terminal(monkeypatch):
    """The far end of a terminal in place of standard input."""
    far, near = os.openpty()
    with os.fdopen(near) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield far
    os.close(far)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_key_that_fails_counts_as_a_lost_terminal(terminal):
    """No key after it is heard, neither q."""
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
