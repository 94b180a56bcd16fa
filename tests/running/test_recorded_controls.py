"""A recorded user's requests come again, and today's user can only lower them."""

import pytest

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import RecordingError
from smarttouch.running.inputs import ControlState
from smarttouch.running.recorded_source import RecordedControls
from smarttouch.running.recording import RecordedRun

from ..raising import raises
from .forged_recordings import put_together, take_apart


@pytest.fixture(params=["sai-levels", "natural"])
def recording(request, golden):
    return RecordedRun(golden(request.param))


def test_every_wish_comes_at_its_time(recording):
    controls = RecordedControls(recording, ControlState(Mode.RA), tuple(Mode))
    steps = [recorded.step for recorded in recording.steps()]
    assert len({(step.mode, step.level) for step in steps}) > 1
    for step in steps:
        wish = controls.state(step.input.time_ns)
        assert (wish.mode, wish.current_level) == (step.mode, step.level)


def test_today_s_user_lowers_and_pauses(recording):
    controls = RecordedControls(recording, ControlState(Mode.RA, 0.5), tuple(Mode))
    step = next(each.step for each in recording.steps() if each.step.level > 0)
    assert controls.state(step.input.time_ns).current_level == 0.5 * step.level
    controls.toggle_pause()
    assert controls.state(step.input.time_ns).current_level == 0
    controls.toggle_pause()
    controls.next_mode()
    controls.choose_mode(Mode.SAI)
    assert controls.state(step.input.time_ns).mode is step.mode


def test_a_board_without_the_recorded_mode_is_refused(golden):
    with raises(RecordingError, names="mode", value="natural"):
        RecordedControls(RecordedRun(golden("natural")), ControlState(Mode.RA), (Mode.RA,))


def test_a_level_above_the_strongest_comfortable_current_is_not_followed(golden, tmp_path):
    about, messages = take_apart(golden("ra"))
    for topic, content, _, _ in messages:
        if topic == "/step":
            content["level"] = 1.5
    put_together(tmp_path / "forged.mcap", about, messages)
    controls = RecordedControls(
        RecordedRun(tmp_path / "forged.mcap"), ControlState(Mode.RA, 0.2), tuple(Mode)
    )
    assert controls.state(10**9).level == 0.2
