"""Runs without a picture: a line for each event, and speech."""

import contextlib
import io
import os
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from rich.console import Console

from smarttouch.errors import SmartTouchError
from smarttouch.events import Paused, Resumed, TrialEvent
from smarttouch.monitor import speech
from smarttouch.monitor.blind_screen import BlindScreen
from smarttouch.monitor.screen import Screen
from smarttouch.monitor.speech import Speech

from ..raising import raises

needs_speech = pytest.mark.skipif(
    None in map(shutil.which, ("spd-say", "speech-dispatcher")), reason=f"needs {speech.INSTALL}"
)

MODULE = 'GenericExecuteSynth "printf \'%s\\\\n\' \'$DATA\' >> {said}"\nAddVoice "en" "MALE1" "x"\n'
SERVER = """
CommunicationMethod "unix_socket"
SocketPath "{folder}/socket"
AddModule "file" "sd_generic" "file.conf"
DefaultModule file
AudioOutputMethod "alsa"
AudioALSADevice "null"
"""


@pytest.fixture
def said(tmp_path_factory, monkeypatch):
    """Start a speech-dispatcher that writes what it is to say; return a reader of that."""
    folder = tmp_path_factory.mktemp("speech")
    (folder / "modules").mkdir()
    (folder / "speechd.conf").write_text(SERVER.format(folder=folder))
    (folder / "modules" / "file.conf").write_text(MODULE.format(said=folder / "said"))
    socket = folder / "socket"
    monkeypatch.setenv("SPEECHD_ADDRESS", f"unix_socket:{socket}")
    command = ["speech-dispatcher", "-s", "-C", folder, "-P", folder / "pid", "-L", folder]
    server = subprocess.Popen(
        [*map(str, command), "-S", str(socket), "-t", "0"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    while server.poll() is None and not socket.exists():
        time.sleep(0.02)

    def lines(enough):
        for _ in range(200):
            text = (folder / "said").read_text() if (folder / "said").exists() else ""
            found = [each for each in text.splitlines() if each]
            if enough(found):
                break
            time.sleep(0.05)
        return found

    yield lines
    # Asked to end, it and its module sometimes wait for each other for ever.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGKILL)
    server.wait()


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


def test_answers_are_neither_shown_nor_said():
    class Answered(TrialEvent):
        reveals = True

    assert BlindScreen("emulator:", quiet=False).hides(Answered(0, "right"))
    assert not Screen("emulator:", quiet=False).hides(Answered(0, "right"))


@needs_speech
def test_lines_and_events_are_said(program_here, said):
    done = program_here(
        "read", "text:one\nit's two", "--as=braille", "--board=simulated:", "--speak", "--pause=0.1"
    )
    assert (done.returncode, done.stderr) == (0, "")
    found = said(lambda lines: any("end of the text" in line for line in lines))
    assert found[0] == "a text"
    assert found.index("line 1: one") < found.index("line 2: it's two")
    assert "mode RA" in found


@needs_speech
def test_intervals_are_marked_by_tones(monkeypatch, said):
    played = []

    def play(tone):
        played.append(tone.stat().st_size)
        return len(played) == 1

    monkeypatch.setattr(speech, "_play", play)
    source = SimpleNamespace(title="gap")
    listener = Speech()
    listener.prepare(SimpleNamespace(source=source))
    for words in ("first", "second", "which was it? 1 or 2"):
        source.title = f"gap, trial 1 of 2: {words}"
        listener.step(None)
    source.title = "!-!!-!PRIORITY"
    listener.step(None)
    found = said(lambda lines: len(lines) > 3)
    listener.close()
    listener.close()
    # What cannot be played is said; and nothing that is said is a command.
    assert found == [
        "gap", "trial 1 of 2: second", "trial 1 of 2: which was it? 1 or 2", "PRIORITY",
    ]  # fmt: skip
    assert len(played) == 2


def test_tones_of_intervals_differ(tmp_path):
    tones = speech._tones(tmp_path)
    assert set(tones) == {"first", "second"}
    assert tones["first"].read_bytes() != tones["second"].read_bytes()


def test_without_speech_dispatcher(monkeypatch):
    monkeypatch.setattr(speech.shutil, "which", lambda _: None)
    with raises(SmartTouchError, about="speech", problem="missing", remedy=speech.INSTALL):
        Speech()
