"""Mistakes in a program's own classes: one sentence with the name of the class."""

from dataclasses import dataclass

import numpy as np
import pytest

import smarttouch as st
from smarttouch.boards.open import MemoryBoard
from smarttouch.types import ForceSource

from ..raising import raises


class Follower(st.Listener):
    def __init__(self):
        self.most = 0


@dataclass
class Strongest(st.Listener):
    most: float = 0.0


class Ring(st.StimulusSource):
    def __init__(self):
        pass

    def read(self, time_ns):
        return None


class Camera(st.OpticalSource):
    knows_force = True

    def __init__(self, returned):
        super().__init__("my camera")
        self.returned = returned

    def read(self, time_ns):
        return self.returned


class Scale(ForceSource):
    def __init__(self, returned=None):
        if returned is not None:
            super().__init__("my scale")
        self.returned = returned

    def read(self, time_ns):
        return self.returned


class Silent(MemoryBoard):
    def __init__(self, rest, limits, output=None):
        pass


class NoNumber(MemoryBoard):
    def _send(self, sequence, times):
        super()._send(sequence, times)


class NoReport(MemoryBoard):
    def report(self):
        return {}


class NoImpedance(MemoryBoard):
    def _measure(self):
        return np.ones(64)


def run(source="text:a", display="memory:", **settings):
    st.run(source, st.open_display(display), seconds=0.1, **settings)


@pytest.mark.parametrize(
    ("kind", "about", "name", "act"),
    [
        (st.SmartTouchError, "listeners", "Follower", lambda: run(listeners=[Follower()])),
        (st.SmartTouchError, "listeners", "Strongest", lambda: run(listeners=[Strongest()])),
        (st.SmartTouchError, "listeners", "Follower", lambda: run(listeners=[Follower])),
        (st.SmartTouchError, "listeners", "str", lambda: run(listeners=["screen"])),
        (st.SourceError, "source", "Ring", lambda: run(Ring())),
        (st.SourceError, "source", "Ring", lambda: next(
            st.steps(Ring(), st.load_profile("electric-mouse")))),
        (st.SourceError, "source", "Camera", lambda: run(Camera(np.zeros((9, 9), np.uint8)))),
        (st.SourceError, "image", "Camera", lambda: run(Camera(st.Frame(np.zeros((9, 9)), 0)))),
        (st.SourceError, "force", "Scale", lambda: run(force=Scale())),
        (st.SourceError, "read", "Scale", lambda: run(force=Scale("0.5"))),
        (st.BoardError, "board", "Silent", lambda: run(display=Silent)),
        (st.BoardError, "board", "Silent", lambda: Silent("", None).open()),
        (st.BoardError, "_send", "NoNumber", lambda: run(display=NoNumber)),
        (st.BoardError, "report", "NoReport", lambda: run(display=NoReport)),
        (st.BoardError, "_measure", "NoImpedance", lambda: run(display=NoImpedance, measure=True)),
    ],
)  # fmt: skip
def test_the_sentence_names_the_class(kind, about, name, act):
    with raises(kind, about=about) as caught:
        act()
    assert name in str(caught.value)


def test_numbers_of_numpy_are_numbers():
    class Numbered(MemoryBoard):
        def _send(self, sequence, times):
            return np.int32(super()._send(sequence, times))

    run(display=Numbered, force=Scale(np.float32(0.5)))
