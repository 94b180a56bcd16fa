"""Mistakes in a program's own classes: one sentence with the name of the class."""

import threading
from dataclasses import dataclass

import numpy as np
import pytest

import smarttouch as st
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


class Waiting(Camera):
    def __init__(self, wait, profile=None):
        super().__init__(None)
        self.wait, self.other, self.news = wait, profile, threading.Event()

    def patience_ns(self, time_ns):
        return self.wait

    def narrowed(self, profile):
        return self.other or profile


def run(source="text:a", display="memory:", **settings):
    st.run(source, st.open_display(display), seconds=0.1, **settings)


@pytest.mark.parametrize(
    ("kind", "name", "act"),
    [
        (st.SmartTouchError, "Follower", lambda: run(listeners=[Follower])),
        (st.SmartTouchError, "str", lambda: run(listeners=["screen"])),
        (st.SourceError, "Camera", lambda: run(Camera(np.zeros((9, 9), np.uint8)))),
        (st.SourceError, "Camera", lambda: run(Camera(st.Frame(np.zeros((9, 9)), 0)))),
        (st.ProfileError, "4", lambda: st.open_source("text:a", 4)),
    ],
)
def test_the_sentence_names_the_class(kind, name, act):
    with raises(kind, names=name):
        act()


def test_a_profile_may_be_named_wherever_one_is_taken():
    step = next(st.steps(st.open_source("text:a", "line-7"), "line-7"))
    assert st.Finger("line-7").profile == st.load_profile(st.load_profile("line-7"))
    assert step.tactile.activation.shape == (3, 7)


def test_numbers_of_numpy_are_numbers():
    run(force=Scale(np.float32(0.5)))
