"""Runs without a picture: a line for each event."""

import io
import os
import sys
from types import SimpleNamespace

import pytest
from rich.console import Console

from smarttouch.events import Paused, Resumed, TrialEvent
from smarttouch.monitor.blind_screen import BlindScreen
from smarttouch.monitor.screen import Screen


def test_events_and_lines_are_told_over_a_pipe_and_keys_work(start_at_a_terminal):
    process, keys = start_at_a_terminal(
        "read", "text:one\ntwo\nthree", "--as=braille", "--plain", "--wait"
    )
    told = []
    for key, expected in ((None, "line 1: one"), (b"\x1b[C", "line 2: two"), (b"m", "mode")):
        if key is not None:
            os.write(keys, key)
        while not any(expected in line for line in told[3:]):
            told.append(process.stdout.readline())
    os.write(keys, b"q")
    rest, wrong = process.communicate(timeout=60)
    assert (process.returncode, wrong) == (0, "")
    assert told[0].startswith("a text, ")
    assert told[1].startswith("keys: ")
    assert "key q" in rest
    assert not any("\x1b" in line for line in told)


@pytest.mark.parametrize(
    ("terminal", "dumb", "asked", "plain"),
    [(True, False, False, False), (True, True, False, True), (True, False, True, True),
     (False, False, False, True)],
)  # fmt: skip
def test_where_nothing_is_drawn(monkeypatch, terminal, dumb, asked, plain):
    monkeypatch.setenv("TERM", "dumb" if dumb else "xterm")
    console = Console(file=io.StringIO(), force_terminal=terminal)
    monkeypatch.setattr("smarttouch.monitor.screen.terminal.console", lambda **_: console)
    run = SimpleNamespace(source=SimpleNamespace(title="a\nb"), profile=SimpleNamespace(title="p"))
    screen = Screen("emulator:", quiet=False, plain=asked)
    screen.event(Paused(1_500_000_000))
    # What happens before the board is open is told when it is.
    assert console.file.getvalue() == ""
    screen.start(run)
    screen.event(Resumed(2_500_000_000))
    told = [each for each in console.file.getvalue().splitlines() if not each.startswith("keys")]
    assert told == ["a b, p, emulator:", "1.5 s: paused", "2.5 s: goes on"] * plain
    quiet = Screen("emulator:", quiet=True, plain=asked)
    quiet.start(run)
    quiet.event(Paused(0))
    assert console.file.getvalue().count("\n") == len(told) + plain * sys.stdin.isatty()


def test_answers_are_not_shown():
    class Answered(TrialEvent):
        reveals = True

    assert BlindScreen("emulator:", quiet=False).hides(Answered(0, "right"))
    assert not Screen("emulator:", quiet=False).hides(Answered(0, "right"))
