"""Fixtures that start runs with a window, each in a thread of the test's process."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.stopping import StopRequest
from smarttouch.running.runner import Runner
from smarttouch.sources.source_contract import Stimulus, StimulusSource
from smarttouch.views.window import Window

from ..support.runs import until
from .browser import chromium

WAIT_S = 60
MARGIN_MM = 1.2  # margin that the page shows around the electrodes
CATHODIC, ANODIC, BASE = (179, 88, 6), (84, 39, 136), (236, 238, 241)


class Spots(StimulusSource):
    """Stimulus source that activates random electrodes and returns random images."""

    knows_force = True

    def __init__(self, profile):
        super().__init__("spots")
        self.profile, self._random = profile, np.random.default_rng(1)
        self.pressed = []

    @property
    def keys(self):
        return {"x": lambda: self.pressed.append("x")}

    def read(self, time_ns):
        self.frames += 1
        active = np.zeros((3, len(self.profile.electrodes)), np.float32)
        active[0, self._random.integers(0, active.shape[1], 5)] = 1
        image = self._random.integers(0, 256, (8, 12), np.uint8)
        full_n = self.profile.force.full_n
        return Stimulus(active, time_ns, full_n, number=self.frames, image=image)


class Run:
    """Run with a window, in a thread of this process."""

    def __init__(self, profile, source, board, rate_hz=None, **options):
        self.stop, self.results = StopRequest(), {}
        self.display, self.source = st.open_display(board, profile), source
        # On a busy computer a page can be slow to answer: do not count it as lost too early.
        usual = {"keys": source.keys, "show": lambda _: None, "lost_s": WAIT_S}
        self.window = Window(self.stop, **usual | options)
        self.board = self.display.board
        self.runner = Runner(
            source, self.display, st.RunConfig(intensity=1.0, rate_hz=rate_hz), stop=self.stop,
            # `keep` precedes the window, so each result on a page is already in ``results``.
            listeners=[self.keep, self.window],
        )  # fmt: skip
        self.thread = threading.Thread(target=self.runner.run)

    def keep(self, result):
        self.results[result.number] = result

    @property
    def address(self):
        return self.window.address

    def state(self):
        return self.window.steering.controls.state(0)

    def ended(self):
        """Wait for the end of the run; return the reason why it ended."""
        self.thread.join(WAIT_S)
        return self.runner.statistics.ended


@pytest.fixture(scope="package")
def browser():
    """Yield one browser for all tests of the folder, because starting it is slow."""
    with chromium() as found:
        yield found


@pytest.fixture
def running(profile):
    """Return a context manager that starts a run with a window and finally stops it."""

    @contextmanager
    def run(source=None, board="memory:", **options):
        given = source or Spots(profile)
        made = Run(getattr(given, "profile", profile), given, board, **options)
        made.thread.start()
        try:
            until(lambda: made.results)
            yield made
        finally:
            made.stop.ask("the test")
            made.thread.join(WAIT_S)
            made.window.close()

    return run


PIXELS = """array => {
  const canvas = document.querySelector('#electrodes');
  const paint = canvas.getContext('2d');
  const longest = Math.max(canvas.width, canvas.height);
  const scale = longest / Math.max(...array.extent);
  return {
    number: Number(canvas.dataset.number),
    slot: canvas.dataset.slot,
    colors: array.places.map(([x, y]) => [...paint.getImageData(
      Math.round(canvas.width / 2 + x * scale),
      Math.round(canvas.height / 2 + (y - 0.7 * array.radius) * scale), 1, 1).data].slice(0, 3)),
  };
}"""


def drawn(page, profile):
    """Return the electrodes' colors on the page, and the numbers of the sequence and slot shown."""
    electrodes = profile.electrodes
    return page.evaluate(PIXELS, {
        "extent": [each + 2 * MARGIN_MM for each in electrodes.extent_mm],
        "places": electrodes.position_mm.tolist(),
        "radius": 0.42 * electrodes.pitch_mm,
    })  # fmt: skip


def colors(current_ua, profile):
    """Return the color that the page must give each electrode, RGB, (E, 3)."""
    part = current_ua / (1000 * float(profile.full_ma.max()))
    target = np.where(part[:, None] < 0, ANODIC, CATHODIC)
    share = np.minimum(1, np.abs(part))[:, None]
    return np.floor(BASE + (target - BASE) * share + 0.5).astype(int)


def strongest(sequence):
    """Return the strongest current of each electrode in a sequence, (E,) µA."""
    current = sequence.current_ua.astype(int)
    if not len(current):
        return np.zeros(current.shape[1], int)
    return np.take_along_axis(current, np.abs(current).argmax(axis=0)[None], axis=0)[0]
