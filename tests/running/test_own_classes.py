"""Mistakes in a program's own classes: one sentence with the name of the class."""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.types import ForceSource

from ..raising import raises


class Follower(st.Listener):
    def __init__(self):
        self.most = 0


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
