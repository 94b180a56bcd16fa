"""Tests of ``--window``: missing libraries, and pages that start, steer and stop a run."""

import json
import re
import signal
import sys
import time
from urllib.parse import urlsplit

import pytest
from websockets.sync.client import connect

from smarttouch.base.errors import SmartTouchError
from smarttouch.running.recording_reader import RecordedRun

from .conftest import refused, says


@pytest.mark.parametrize("library", ["uvicorn", "starlette"])
def test_without_the_extra_it_says_which(program_here, monkeypatch, library):
    for name in [library, *(each for each in sys.modules if each.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    done = program_here("live --window --board simulated:")
    says(SmartTouchError, "smarttouch[window]")(refused(done))


FIRST = re.compile("window: (http://[^ ]+) ")


def receive(page, kind):
    """Return the next message of a kind. Answer each earlier update with "seen"."""
    while True:
        message = json.loads(page.recv(timeout=60))
        if message["type"] == kind:
            return message
        if message["type"] == "update":
            page.send("seen")


def test_a_window_waits_for_its_page_and_shows_the_end_until_that_is_closed(start_program):
    run = start_program("live", "text:a?passes=1", "--window", "--profile", "smarttouch-4x4")
    address = FIRST.match(run.stderr.readline())[1]
    # The run waits for its page; otherwise the single letter would have been read by now.
    time.sleep(0.6)
    assert run.poll() is None
    with page_of(address) as page:
        receive(page, "hello")
        last = {}
        while (message := json.loads(page.recv(timeout=60)))["type"] == "update":
            last |= message
            page.send("seen")
        assert not message["failed"]
        assert last["state"]["sequences"] > 10
        assert run.poll() is None
    assert run.wait(60) == 0


def test_a_window_nobody_opens_is_given_up(start_program):
    run = start_program("live", "--window")
    assert FIRST.match(run.stderr.readline())
    run.send_signal(signal.SIGINT)
    assert run.wait(60) == 128 + signal.SIGINT


def page_of(address):
    """Return a socket that acts as the page at an address."""
    place = urlsplit(address)
    secret = place.path.split("/")[1]
    return connect(
        f"ws://{place.netloc}/{secret}/socket", origin=f"http://{place.netloc}", proxy=None
    )


def state(page):
    """Return the state in the next update of a page, and the picture or None."""
    while True:
        message = json.loads(page.recv(timeout=20))
        if message["type"] == "update":
            page.send("seen")
            return message["state"], message.get("picture")


def test_on_a_finger_a_page_turns_it_up_from_nothing(start_program, start_emulator, tmp_path):
    _, port, _ = start_emulator()
    run = start_program(
        "live", "--board", f"link:{port}", "--force", "fixed:1", "--window",
        "text:touch touch?speed_mm_s=2", "--record", "run.mcap",
    )  # fmt: skip
    address = FIRST.match(run.stderr.readline())[1]
    with page_of(address) as page:
        while (now := state(page))[1] is None:
            assert now[0]["level"] == 0
        assert now[1]["intensity"] == 0
        page.send("do more")
        while not (state(page)[1] or {}).get("intensity"):
            pass
    # The page has disconnected, and there is no keyboard: the run must pause.
    with page_of(address) as page:
        # Wait until no current flows: then the loop has paused as well.
        while not (now := state(page))[0]["paused"] or (now[1] or {}).get("intensity") != 0:
            pass
        assert now[0]["level"] > 0
        page.send("stop")
        receive(page, "ended")
    assert run.wait(60) == 0
    recording = RecordedRun(tmp_path / "run.mcap")
    words = [words for _, words in recording.events]
    assert [each for each in words if each in ("intensity 0.00", "intensity 0.05", "paused")] == [
        "intensity 0.00", "intensity 0.05", "paused",
    ]  # fmt: skip
    assert not [*recording.steps()][-1].step.sequence.current_ua.any()
