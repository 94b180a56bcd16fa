"""One page steers; a run that no page steers any more is paused where pages are alone."""

import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.stopping import StopRequest
from smarttouch.running.inputs import STEP, Controls, ControlState
from smarttouch.views import window_pages
from smarttouch.views.window_pages import Steering

from ..raising import raises


@pytest.fixture
def now_s(monkeypatch):
    """A clock that is set by hand, in s."""
    now = [100.0]
    monkeypatch.setattr(window_pages.time, "monotonic", lambda: now[0])
    return now


def make(alone=True, most=1.0):
    controls = Controls(ControlState(Mode.RA, 0.5), (Mode.RA, Mode.SAI))
    controls.most, stop, pressed = most, StopRequest(), []
    keys = {"r": lambda: pressed.append("r")}
    return Steering(controls, stop, keys, alone=alone), controls, stop, pressed


def test_requests_of_a_page_act_as_keys():
    window_pages, controls, stop, pressed = make(most=0.5 + STEP)
    for what, expected in (
        ("more", ControlState(Mode.RA, 0.5 + STEP)),
        ("more", ControlState(Mode.RA, 0.5 + STEP)),
        ("less", ControlState(Mode.RA, 0.5)),
        ("mode:SAI", ControlState(Mode.SAI, 0.5)),
        ("pause", ControlState(Mode.SAI, 0.5, paused=True)),
        ("pause", ControlState(Mode.SAI, 0.5, paused=True)),
        ("resume", ControlState(Mode.SAI, 0.5)),
        ("level:0.25", ControlState(Mode.SAI, 0.25)),
        ("none", ControlState(Mode.SAI, 0.0)),
        ("key:r", ControlState(Mode.SAI, 0.0)),
    ):
        assert window_pages.act(1, what)
        assert controls.state(0) == expected
    assert pressed == ["r"]
    assert not stop.event.is_set()


@pytest.mark.parametrize(
    "what", ["", "most", "level:", "level:x", "mode:PC", "mode:nothing", "key:q", "key:", "stop"]
)
def test_nothing_else_can_be_asked_for(what):
    window_pages, controls, _, _ = make()
    before = controls.state(0)
    with pytest.raises(ValueError):
        window_pages.act(1, what)
    assert controls.state(0) is before
    assert window_pages.page is None


@pytest.mark.parametrize("level", ["0.6", "-0.1", "nan", "inf"])
def test_a_level_beyond_the_limit_is_refused(level):
    steering, controls, _, _ = make(most=0.55)
    before = controls.state(0)
    with raises(SmartTouchError, names="intensity"):
        steering.act(1, f"level:{level}")
    assert controls.state(0) is before


def test_one_page_steers_until_it_leaves():
    window_pages, controls, _, _ = make()
    assert window_pages.act(1, "less")
    level = controls.state(0).level
    assert not window_pages.act(2, "more")
    assert not window_pages.steer(2)
    window_pages.leave(2)
    assert (window_pages.page, controls.state(0).level) == (1, level)
    window_pages.leave(1)
    assert controls.state(0).paused
    assert window_pages.act(2, "resume")
    assert (window_pages.page, controls.state(0).current_level) == (2, level)


@pytest.mark.parametrize("alone", [True, False])
def test_a_page_that_falls_silent_steers_no_longer(now_s, alone):
    steer, controls, _, _ = make(alone)
    steer.steer(1)
    now_s[0] += 0.9 * window_pages.LOST_S
    steer.look_after()
    steer.note_alive(1)
    now_s[0] += 0.9 * window_pages.LOST_S
    steer.note_alive(2)
    steer.look_after()
    assert steer.page == 1
    now_s[0] += 0.2 * window_pages.LOST_S
    steer.look_after()
    assert steer.page is None
    assert controls.state(0).paused is alone


def test_nobody_is_missed_who_never_steered(now_s):
    window_pages, controls, _, _ = make()
    now_s[0] += 60
    window_pages.look_after()
    window_pages.leave(7)
    assert not controls.state(0).paused
