"""Mistakes in a program's own classes: one sentence with the name of the class."""

import threading
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


class Touched(MemoryBoard):
    on_a_finger, simulated_time = True, False
    _time = st.Board._time


class NoVoltages(MemoryBoard):
    def take_volts(self):
        return np.ones(64)


class Waiting(Camera):
    def __init__(self, wait, profile=None):
        super().__init__(None)
        self.wait, self.other, self.news = wait, profile, threading.Event()

    def patience_ns(self, time_ns):
        return self.wait

    def narrowed(self, profile):
        return self.other or profile


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
        (st.BoardError, "take_volts", "NoVoltages", lambda: run(display=NoVoltages)),
        (st.SourceError, "patience_ns", "Waiting", lambda: run(Waiting(0.5), "emulator:")),
        (st.SourceError, "narrowed", "Waiting", lambda: run(
            Waiting(0, "finer"), Touched, force="fixed:1", intensity=0.1)),
        (st.ProfileError, "profile", "4", lambda: st.open_source("text:a", 4)),
        (st.BoardError, "report", "NoReport", lambda: run(display=NoReport)),
        (st.BoardError, "_measure", "NoImpedance", lambda: run(display=NoImpedance, measure=True)),
    ],
)  # fmt: skip
def test_the_sentence_names_the_class(kind, about, name, act):
    with raises(kind) as caught:
        act()
    assert name in str(caught.value)


def test_a_profile_may_be_named_wherever_one_is_taken():
    step = next(st.steps(st.open_source("text:a", "line-7"), "line-7"))
    assert st.Finger("line-7").profile == st.load_profile(st.load_profile("line-7"))
    assert step.tactile.activation.shape == (3, 7)


def test_numbers_of_numpy_are_numbers():
    class Numbered(MemoryBoard):
        def _send(self, sequence, times):
            return np.int32(super()._send(sequence, times))

    run(display=Numbered, force=Scale(np.float32(0.5)))
