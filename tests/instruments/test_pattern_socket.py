"""Runs that other programs control through a socket: even bad requests are answered."""

import json
import re
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.errors import SourceError

from ..support.checks import raises
from ..support.runs import until

DOT = np.eye(64)[27].tolist()
RING = [float(each in (18, 19, 20, 26, 28, 34, 35, 36)) for each in range(64)]


class Client:
    """Program that is connected to the socket of a run."""

    def __init__(self, path):
        with socket.socket(socket.AF_UNIX) as line:
            line.connect(str(path))
            self.file = line.makefile("rwb", buffering=0)

    def send(self, request):
        data = request if isinstance(request, bytes) else json.dumps(request).encode()
        self.file.write(data + b"\n")

    def read(self):
        return json.loads(self.file.readline() or "null")

    def ask(self, request, **fields):
        self.send({"request": request, **fields})
        return self.read()


@pytest.fixture
def opened(tmp_path):
    """Return a class. Each of its objects is a run that a socket controls."""
    doors = []

    class Door:
        def __init__(self, url="memory:", mode="RA"):
            self.path, self.steps, self.clients = tmp_path / "door", [], []
            self.display = st.open_display(url, "electric-mouse")
            self.source = st.open_source(f"socket:{self.path}", self.display.profile)
            self.thread = threading.Thread(target=self.run, args=(mode,))
            self.thread.start()
            doors.append(self)

        def run(self, mode):
            self.statistics = st.run(
                self.source, self.display, mode=mode, intensity=0.6, listeners=[self.steps.append]
            )

        def client(self):
            self.clients.append(Client(self.path))
            return self.clients[-1]

        def pulsed(self):
            """Return the active electrodes of each pattern that was sent, as a set of tuples."""
            rows = [each.tactile.activation for each in [*self.steps] if each.sequence.slots]
            return {tuple(np.flatnonzero(each.any(axis=0)).tolist()) for each in rows}

        def silent(self):
            return not self.steps[-1].sequence.slots

    yield Door
    for door in doors:
        for client in door.clients:
            client.file.close()
        door.source.end()
        door.thread.join()


@pytest.mark.parametrize("url", ["memory:", "emulator:", "simulated:"])
def test_a_client_shows_and_stops(opened, url):
    door = opened(url)
    client = door.client()
    shown = client.ask("show", pattern=RING, seconds=0.5)
    assert (shown["ok"], shown["request"], shown["intensity"]) == (True, "show", 0.6)
    assert (shown["sequences"], shown["ramped_s"] > 0.2) == (25, True)
    assert client.ask("show", pattern=DOT, seconds=0.1, level=0.5)["intensity"] == 0.3
    assert client.ask("stop") == {"ok": True, "request": "stop"}
    assert client.read() is None
    door.thread.join()
    assert door.statistics.ended == "a program stopped the run through the socket"
    assert not door.path.exists()
    assert door.pulsed() == {tuple(np.flatnonzero(RING)), (27,)}


def test_the_newest_pattern_wins(opened):
    door = opened()
    client, other = door.client(), door.client()
    for pattern in (DOT, RING):
        client.send({"request": "show", "pattern": pattern, "seconds": 30})
    assert "newer" in client.read()["error"]
    until(lambda: tuple(np.flatnonzero(RING)) in door.pulsed())
    assert other.ask("put", pattern=DOT)["ok"]
    assert "newer" in client.read()["error"]
    before = other.ask("status")
    for row in np.eye(64).tolist():
        other.send({"request": "put", "pattern": row})
    assert all(other.read()["ok"] for _ in range(64))
    until(lambda: (63,) in door.pulsed())
    after = other.ask("status")
    assert after["patterns"] - before["patterns"] >= 64
    assert after["dropped"] > before["dropped"]
    # A pattern ends after 0.5 s without a new pattern.
    until(door.silent)


@pytest.mark.parametrize("request_", [
    {"request": "show", "pattern": DOT, "seconds": 60}, {"request": "put", "pattern": DOT},
])  # fmt: skip
def test_a_lost_client_ends_its_pulses(opened, request_):
    door = opened()
    client = door.client()
    client.send(request_)
    until(door.pulsed)
    client.file.close()
    until(door.silent)
    time.sleep(0.2)
    assert door.silent()
    assert door.client().ask("show", pattern=RING, seconds=0.1)["ok"]


def test_the_client_of_the_page_works(opened, capsys):
    page = Path(__file__).parents[2] / "docs/how-to/programs.md"
    program = re.search(r"```python\n(import json.*?)```", page.read_text("utf-8"), re.DOTALL)[1]
    door, names = opened(), {}
    exec(program.replace('"./touch"', repr(str(door.path))), names)
    door.thread.join()
    names["line"].close()
    names["answers"].close()
    assert "'sequences': 25" in capsys.readouterr().out


NAN = float("nan")
WRONG = [
    b"", b"}", b"7", b"[]", b"\xff", b"[" * 100_000, b'{"request": "show"', b" " * 4_000_001,
    *({"request": each} for each in ("rise", "show", "put", "level")),
    *({"request": "show", "pattern": DOT, "seconds": each} for each in (61, 0, "1", NAN)),
    *({"request": "show", "pattern": DOT, "level": each} for each in (2.0, 0.0, True, NAN)),
    *({"request": "level", "level": each} for each in (1.1, -1, True, NAN)),
    *({"request": "put", "pattern": [each] * 64} for each in (2.0, -0.1, NAN, True, 10**400)),
    *({"request": "put", "pattern": each} for each in ([], [1.0] * 63, [[1.0], [1.0, 0.0]])),
    {"request": "put", "pattern": [[0.0] * 64, [0.0] * 64, [1.0] * 64]},
    *({"request": "put", "image": each}
      for each in ([], [[], []], [[256]], [[0.5]], [[0], [0, 1]], [0] * 64)),
    {"request": "put", "pattern": DOT, "image": [[0]]},
    {"request": "put", "pattern": DOT, "force_n": 0.9},
]  # fmt: skip


def test_bad_requests_are_answered_and_the_run_goes_on(opened):
    door = opened()
    for wrong in WRONG:
        client = door.client()
        client.send(wrong)
        answer = client.read()
        assert (answer["ok"], "\n" in answer["error"]) == (False, False), wrong
    assert door.pulsed() == set()
    assert door.client().ask("show", pattern=DOT, seconds=0.1)["sequences"] == 5


@pytest.mark.parametrize(("mode", "shown"), [
    ("SAI", {"pattern": DOT}), ("PC", {"pattern": [1.0] * 64}), ("RA", {"pattern": [1.0] * 64}),
    ("natural", {"pattern": [[1.0] * 64, [1.0] * 64, [0.0] * 64]}),
    ("RA", {"image": [[255] * 30 + [0] * 4 + [255] * 30] * 64}),
])  # fmt: skip
def test_patterns_and_images_in_each_mode(opened, mode, shown):
    door = opened("simulated:", mode)
    assert door.client().ask("show", seconds=0.2, **shown)["pulses"] > 0


def test_a_client_sets_the_level_as_keys_do_and_ends_no_pause(opened):
    door = opened()
    client = door.client()
    assert client.ask("level", level=0.5)["ok"]
    assert client.ask("show", pattern=DOT, seconds=0.1)["intensity"] == 0.5
    door.source.controls.most = 0.5
    assert "0.5" in client.ask("level", level=0.6)["error"]
    door.source.controls.pause()
    assert client.ask("level", level=0.4)["ok"]
    status = client.ask("status")
    assert (status["level"], status["most_level"], status["paused"]) == (0.4, 0.5, True)
    assert (status["electrodes"], status["mode"]) == (64, "RA")
    count = len(door.steps)
    assert client.ask("put", pattern=RING)["ok"]
    until(lambda: len(door.steps) > count + 5)
    assert all(not each.sequence.slots for each in door.steps[count:])


def test_who_gets_past_the_mode_is_turned_away(opened, monkeypatch):
    door = opened()
    assert door.path.stat().st_mode & 0o777 == 0o600
    with monkeypatch.context() as patch:
        patch.setattr("smarttouch.instruments.pattern_socket.user_number", lambda: -2)
        assert door.client().read() is None
    assert door.client().ask("status")["ok"]


@pytest.mark.parametrize(
    "path", ["", "9000", "./a?activation", "/none/there", "/dev/null", "x" * 200]
)
def test_what_is_no_place_is_refused(profile, path):
    with raises(SourceError, value=path):
        st.open_source(f"socket:{path}", profile)


def test_a_place_that_is_taken_is_refused_and_one_that_was_left_is_not(profile, tmp_path):
    path = tmp_path / "door"
    with st.open_source(f"socket:{path}", profile) as source:
        assert not source.measures_force
        with raises(SourceError, value=str(path)):
            st.open_source(f"socket:{path}", profile)
    assert not path.exists()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    st.open_source(f"socket:{path}", profile).close()
    assert not path.exists()
