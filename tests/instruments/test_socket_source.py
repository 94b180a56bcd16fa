"""The door for other programs: each request has an answer, and none breaks the run."""

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
from smarttouch.testing import StimulusContract

from ..raising import raises
from ..waiting import until

pytestmark = pytest.mark.usefixtures("patient_boards")

DOT = np.eye(64)[27].tolist()
RING = [float(each in (18, 19, 20, 26, 28, 34, 35, 36)) for each in range(64)]


class Client:
    """A program that is connected."""

    def __init__(self, path):
        self.line = socket.socket(socket.AF_UNIX)
        self.line.connect(str(path))
        self.answers = self.line.makefile("rb")

    def send(self, *requests):
        self.line.sendall(b"".join(
            (each if isinstance(each, bytes) else json.dumps(each).encode()) + b"\n"
            for each in requests
        ))  # fmt: skip

    def read(self):
        return json.loads(self.answers.readline() or "null")

    def ask(self, request, **fields):
        self.send({"request": request, **fields})
        return self.read()

    def close(self):
        self.answers.close()
        self.line.close()


class Door:
    """A run that is steered through a socket."""

    def __init__(self, path, url="memory:", mode="RA"):
        self.path, self.steps, self.clients = path, [], []
        profile = st.load_profile("electric-mouse")
        self.source = st.open_source(f"socket:{path}", profile)
        self.display = st.open_display(url, profile)
        self.settings = {"mode": mode, "intensity": 0.6, "listeners": [self.steps.append]}
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        self.statistics = st.run(self.source, self.display, **self.settings)

    def client(self):
        self.clients.append(Client(self.path))
        return self.clients[-1]

    def activations(self):
        """Return the patterns that pulsed, each once."""
        pulsed = [each.tactile.activation for each in [*self.steps] if each.sequence.slots]
        return {tuple(np.flatnonzero(each.any(axis=0)).tolist()) for each in pulsed}

    def silent(self):
        return not self.steps[-1].sequence.slots


@pytest.fixture
def opened(tmp_path):
    doors = []

    def open_door(*given, **named):
        doors.append(Door(tmp_path / f"door-{len(doors)}", *given, **named))
        return doors[-1]

    yield open_door
    for door in doors:
        for client in door.clients:
            client.close()
        door.source.end()
        door.thread.join()


@pytest.mark.parametrize("url", ["memory:", "emulator:", "simulated:"])
def test_a_client_shows_and_stops(opened, url):
    door = opened(url)
    client = door.client()
    shown = client.ask("show", pattern=RING, seconds=0.5)
    assert (shown["ok"], shown["request"], shown["intensity"]) == (True, "show", 0.6)
    assert shown["sequences"] == 25
    assert shown["pulses"] >= 25
    assert shown["ramped_s"] > 0.2
    assert client.ask("show", pattern=DOT, seconds=0.1, level=0.5)["intensity"] == 0.3
    assert client.ask("stop") == {"ok": True, "request": "stop"}
    assert client.read() is None
    door.thread.join()
    assert door.statistics.ended == "a program stopped it through the socket"
    assert not door.path.exists()
    assert door.activations() == {tuple(np.flatnonzero(RING)), (27,)}


def test_the_newest_pattern_wins(opened):
    door = opened()
    client, other = door.client(), door.client()
    client.send(*({"request": "show", "pattern": each, "seconds": 30} for each in (DOT, RING)))
    assert "newer" in client.read()["error"]
    until(lambda: tuple(np.flatnonzero(RING)) in door.activations())
    assert other.ask("put", pattern=DOT)["ok"]
    assert "newer" in client.read()["error"]
    before = other.ask("status")
    other.send(*({"request": "put", "pattern": np.eye(64)[each].tolist()} for each in range(64)))
    assert [other.read()["ok"] for _ in range(64)] == 64 * [True]
    until(lambda: (63,) in door.activations())
    after = other.ask("status")
    assert after["patterns"] - before["patterns"] >= 64
    assert after["dropped"] > before["dropped"]
    # Half a second without another one is nothing.
    until(door.silent)


@pytest.mark.parametrize("request_", [
    {"request": "show", "pattern": DOT, "seconds": 60},
    {"request": "put", "pattern": DOT},
])  # fmt: skip
def test_a_lost_client_ends_its_pulses(opened, request_):
    door = opened()
    client = door.client()
    client.send(request_)
    until(lambda: any(each.sequence.slots for each in door.steps))
    client.close()
    until(door.silent)
    left_s = time.monotonic() + 0.3
    while time.monotonic() < left_s:
        assert door.silent()
    assert door.client().ask("show", pattern=RING, seconds=0.1)["ok"]


def test_the_client_of_the_page_works(opened, capsys):
    page = Path(__file__).parents[2] / "docs/how-to/other-programs.md"
    program = re.search(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)[1]
    door = opened()
    namespace = {}
    exec(program.replace('"./touch"', repr(str(door.path))), namespace)
    door.thread.join()
    namespace["line"].close()
    namespace["answers"].close()
    assert "'sequences': 25" in capsys.readouterr().out


WRONG = [
    b"", b"}", b"7", b"[]", b"\xff", b"[" * 100_000, b'{"request": "show"',
    {"request": "rise"}, {"request": "show"}, {"request": "status", "force": 1},
    {"request": "show", "pattern": DOT, "seconds": 61},
    {"request": "show", "pattern": DOT, "seconds": 0},
    {"request": "show", "pattern": DOT, "seconds": "1"},
    {"request": "show", "pattern": DOT, "level": 2.0},
    {"request": "show", "pattern": DOT, "level": 0.0},
    {"request": "put", "pattern": DOT, "force_n": 0.9},
    {"request": "put", "pattern": DOT, "image": [[0]]},
    {"request": "put", "pattern": [2.0] * 64}, {"request": "put", "pattern": [-0.1] * 64},
    {"request": "put", "pattern": [float("nan")] * 64}, {"request": "put", "pattern": [1.0] * 63},
    {"request": "put", "pattern": [True] * 64}, {"request": "put", "pattern": [10**400] * 64},
    {"request": "put", "pattern": []}, {"request": "put", "pattern": [[1.0], [1.0, 0.0]]},
    {"request": "put", "pattern": [[0.0] * 64, [0.0] * 64, [1.0] * 64]},
    {"request": "put", "image": []}, {"request": "put", "image": [[], []]},
    {"request": "put", "image": [[256]]}, {"request": "put", "image": [[0.5]]},
    {"request": "put", "image": [[0], [0, 1]]}, {"request": "put", "image": [0] * 64},
    {"request": "level"}, {"request": "level", "level": 1.1}, {"request": "level", "level": -1},
    {"request": "level", "level": float("nan")}, {"request": "level", "level": True},
    b'{"request": "put", "pattern": "' + b"x" * 4_000_000 + b'"}',
]  # fmt: skip


def test_bad_requests_are_answered_and_the_run_goes_on(opened):
    door = opened()
    for wrong in WRONG:
        client = door.client()
        client.send(wrong)
        answer = client.read()
        assert answer["ok"] is False, wrong
        assert answer["error"], wrong
        assert "\n" not in answer["error"]
        client.close()
    assert door.activations() == set()
    assert door.client().ask("show", pattern=DOT, seconds=0.1)["sequences"] == 5


@pytest.mark.parametrize(("mode", "shown"), [
    ("SAI", {"pattern": DOT}), ("PC", {"pattern": [1.0] * 64}), ("RA", {"pattern": [1.0] * 64}),
    ("natural", {"pattern": [[1.0] * 64, [1.0] * 64, [0.0] * 64]}),
    ("RA", {"image": [[255] * 30 + [0] * 4 + [255] * 30] * 64}),
])  # fmt: skip
def test_patterns_and_images_in_each_mode(opened, mode, shown):
    door = opened("simulated:", mode)
    assert door.client().ask("show", seconds=0.2, **shown)["pulses"] > 0


def test_a_client_sets_the_level_as_keys_do_and_no_pause_ends(opened):
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


def test_a_force_is_asked_for_where_a_finger_may_be(opened, tmp_path):
    profile = st.load_profile("electric-mouse")
    with st.open_source(f"socket:{tmp_path / 'door'}", profile) as source:
        assert source.knows_force
        assert not source.measures_force


CLIENT = """
import socket, sys
try:
    socket.socket(socket.AF_UNIX).connect(sys.argv[1])
    print("connected")
except OSError as error:
    print(type(error).__name__)
"""


def test_another_user_cannot_connect(profile, other_account, tmp_path):
    path = tmp_path / "door"
    with (
        st.open_source(f"socket:{path}", profile),
        other_account("-c", CLIENT, path) as other,
    ):
        assert path.stat().st_mode & 0o777 == 0o600
        assert other.stdout.readline() == "PermissionError\n"


def test_who_gets_past_the_mode_is_turned_away(opened, monkeypatch):
    monkeypatch.setattr("smarttouch.instruments.socket_source.user_number", lambda: -2)
    door = opened()
    assert door.client().read() is None
    monkeypatch.undo()
    assert door.client().ask("status")["ok"]


@pytest.mark.parametrize(
    "path", ["", "9000", "./a?activation", "/none/there", "/dev/null", "x" * 200]
)
def test_what_is_no_place_is_refused(profile, path):
    with raises(SourceError, value=path):
        st.open_source(f"socket:{path}", profile)


def test_a_place_that_is_taken_is_refused_and_one_that_was_left_is_not(profile, tmp_path):
    path = tmp_path / "door"
    with st.open_source(f"socket:{path}", profile):
        with raises(SourceError, value=str(path)):
            st.open_source(f"socket:{path}", profile)
        Client(path).close()
    assert not path.exists()
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    st.open_source(f"socket:{path}", profile).close()
    assert not path.exists()


class TestSocket(StimulusContract):
    ends = False

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path):
        self.folder, self.count = tmp_path, 0

    def make(self, profile):
        self.count += 1
        return st.open_source(f"socket:{self.folder / str(self.count)}", profile)

    def make_impossible(self, profile):
        st.open_source("socket:9000", profile)
