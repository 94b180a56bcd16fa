"""Whatever happens to a line, for as long as it likes: nothing unsafe ever flows.

``pytest tests/boards/test_random_faults.py --runs 600 --timeout 0 -s`` for 600 seconds of
each, and figures.
"""

import random
import threading
import time
from collections import deque

import pytest

from smarttouch.base.errors import BoardError, BoardRestartedError
from smarttouch.emulator.firmware import read_state
from tests.boards.conftest import FIRMWARES
from tests.boards.fresh import HANGS_S
from tests.support.full import WHOLE

SECONDS = 2 if WHOLE else 1
pytestmark = pytest.mark.realtime


class Weather:
    """Something goes wrong with one piece in so many."""

    def __init__(self, seed, doubles, replays):
        self.random = random.Random(seed)
        self.kinds = ["drop", "cut", "none", "swallow"] + ["double"] * doubles
        self.kinds += ["again"] * replays
        self.before = deque(maxlen=1000)
        self.counts = dict.fromkeys(self.kinds, 0)

    def __call__(self, data):
        if not data:
            return data
        self.before.append(data)
        if self.random.random() > 0.03:
            return data
        kind, where = self.random.choice(self.kinds), self.random.randrange(len(data))
        self.counts[kind] += 1
        return {
            "drop": data[:where] + data[where + 1 :],
            "double": data[: where + 1] + data[where:],
            "cut": data[:where],
            "swallow": b"",
            # Between zeros, so that what was whole is whole again.
            "again": data + b"\0" + self.random.choice(self.before) + b"\0",
            "none": data,
        }[kind]


@pytest.mark.parametrize("hosted", [
    "link", "link C", "kajimoto61", "etactilekit", "etactilekit newest", FIRMWARES[1],
], indirect=True)  # fmt: skip
def test_nothing_unsafe_flows(hosted, runs):
    runs = runs or SECONDS
    # USB and TCP lose bytes only by whole pieces or at their end; they never double one.
    weather = Weather(1, doubles=hosted.kind != "etactilekit", replays=hosted.kind == "link")
    hosted.line.to_board = hosted.line.to_host = weather
    begun = time.monotonic()
    opened = sent = restarts = 0
    sentences = []

    def over():
        # A busy machine takes longer to send anything.
        seconds = time.monotonic() - begun
        return seconds > runs and (sent > 0 or seconds > HANGS_S)

    while not over():
        hosted.step = 0
        try:
            with hosted.board:
                opened += 1
                pull = threading.Timer(weather.random.uniform(1, 20), unplug, [hosted.line])
                pull.start()
                try:
                    while not over():
                        try:
                            hosted.send(times=weather.random.choice([1, 1, 1, 4]))
                            sent += 1
                        except BoardRestartedError:
                            restarts += 1
                finally:
                    pull.cancel()
                    pull.join()
        except BoardError as error:
            sentences.append(str(error))
    hosted.line.to_board = hosted.line.to_host = bytes
    time.sleep(0.4)
    state = read_state(hosted.folder)
    print(
        f"\n{hosted.kind}: {runs:g} s, {sent} sequences, {state['slots']} slots; "
        f"{weather.counts}; opened {opened}, restarts {restarts}, faults {len(sentences)}; "
        f"unsafe slots {state['unsafe']}, old packets {state['old_packets']}"
    )
    assert sent > 0
    assert not any("\n" in sentence for sentence in sentences)
    assert state["unsafe"] == 0


def unplug(line):
    line.pull_out()
    time.sleep(0.5)
    line.plug_in()
