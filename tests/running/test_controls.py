"""Tests of the user's controls: level between 0 and its limit, pause, and modes."""

import pytest

from smarttouch.base.afferent import Mode
from smarttouch.running.loop import STEP, Controls, ControlState


@pytest.mark.parametrize("most", [1.0, 0.12])
def test_keys_go_from_nothing_to_the_most_that_is_allowed(most):
    controls, levels = Controls(ControlState(Mode.RA, 0.0)), []
    controls.most = most
    for by in [STEP] * 25 + [-STEP] * 25:
        controls.change_level(by)
        levels.append(controls.state(0).level)
    assert levels[:2] == [0.05, 0.1]
    assert (levels[24], levels[49]) == (most, 0)


def test_pause_keeps_the_level():
    controls = Controls(ControlState(Mode.RA, 0.5))
    controls.toggle_pause()
    assert controls.state(0).current_level == 0
    controls.toggle_pause()
    assert controls.state(0).current_level == 0.5
    controls.silence()
    assert controls.state(0).current_level == 0


def test_modes_go_round():
    controls = Controls(ControlState(Mode.SAI), (Mode.RA, Mode.SAI, Mode.NATURAL))
    modes = []
    for _ in range(4):
        controls.next_mode()
        modes.append(controls.state(0).mode)
    assert modes == [Mode.NATURAL, Mode.RA, Mode.SAI, Mode.NATURAL]


@pytest.mark.parametrize("level", [-0.1, 1.1, float("nan")])
def test_no_other_level_can_be_wished(level):
    with pytest.raises(ValueError) as error:
        ControlState(Mode.RA, level)
    assert str(level) in str(error.value)
