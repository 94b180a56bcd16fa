"""Events of the emulated finger, and their notation."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError
from smarttouch.emulator.finger_events import FORMS, EmulatedFinger, parse_event
from smarttouch.emulator.skin import SkinCircuit

from ..raising import raises

HEALTHY = SkinCircuit(16).series_ohm


def at(now_s, *events, skin=None):
    finger, skin = EmulatedFinger(16, events), skin or SkinCircuit(16)
    finger.at(now_s, skin)
    return finger, skin


def test_a_finger_without_events_changes_nothing():
    finger, skin = at(100.0)
    np.testing.assert_array_equal(skin.series_ohm, HEALTHY)
    assert finger.force_n == pytest.approx(1.0)


def test_lifting_opens_every_electrode_and_touching_is_as_before():
    finger, skin = EmulatedFinger(16, ["3.0 touch", "2 lift", "0 force 0.9"]), SkinCircuit(16)
    finger.at(1.9, skin)
    assert finger.force_n == pytest.approx(0.9)
    finger.at(2.0, skin)
    assert finger.force_n == 0
    assert (skin.series_ohm > 5e8).all()
    current = np.full(16, -100.0)
    current[0] = 1500
    assert np.abs(skin.pulse(current, 100).current_ua).max() < 1
    finger.at(3.0, skin)
    np.testing.assert_allclose(skin.series_ohm, HEALTHY)
    assert finger.force_n == pytest.approx(0.9)


def test_a_drift_is_smooth_and_ends_where_set():
    finger, skin = EmulatedFinger(16, ["10 drift 12 4 60"]), SkinCircuit(16)
    for now_s, factor in ((9, 1), (10, 1), (40, 2), (70, 4), (500, 4)):
        finger.at(now_s, skin)
        assert skin.series_ohm[12] / HEALTHY[12] == pytest.approx(factor, rel=0.01)
        assert skin.parallel_ohm[12] * skin.capacitance_f[12] == pytest.approx(
            (SkinCircuit(16).parallel_ohm * SkinCircuit(16).capacitance_f)[12]
        )
    np.testing.assert_allclose(np.delete(skin.series_ohm, 12), np.delete(HEALTHY, 12))


def test_a_drift_in_many_small_steps_ends_at_the_same():
    finger, skin = EmulatedFinger(16, ["0 drift 3 4 1", "0.5 drift 3 1 1"]), SkinCircuit(16)
    seen = []
    for now_s in np.arange(0, 2, 0.001):
        finger.at(now_s, skin)
        seen.append(skin.series_ohm[3] / HEALTHY[3])
    assert max(seen) == pytest.approx(2, rel=0.01)
    assert seen[-1] == pytest.approx(1)
    assert np.abs(np.diff(seen)).max() < 0.03


def test_one_electrode_peels_breaks_is_shorted_and_heals():
    _, skin = at(5, "5 peel 7 0.3")
    assert skin.series_ohm[7] == pytest.approx(HEALTHY[7] / 0.3)
    assert skin.capacitance_f[7] == pytest.approx(SkinCircuit(16).capacitance_f[7] * 0.3)
    _, skin = at(5, "5 open 7")
    assert skin.series_ohm[7] > 5e8
    _, skin = at(5, "5 short 7")
    assert skin.series_ohm[7] + skin.parallel_ohm[7] < 10
    broken = ["1 peel 7 0.3", "1 open 7", "1 short 7", "1 drift 7 9 100"]
    _, skin = at(6, *broken, "5 heal 7")
    np.testing.assert_allclose(skin.series_ohm, HEALTHY)


def test_a_change_leaves_the_voltage_on_an_electrode():
    skin = SkinCircuit(16)
    skin.pulse(np.r_[1500.0, np.full(15, -100.0)], 100)
    volts = skin.residual_uc / skin.capacitance_f
    at(1, "1 peel 0 0.5", skin=skin)
    np.testing.assert_allclose(skin.residual_uc / skin.capacitance_f, volts)


@pytest.mark.parametrize(("text", "allowed"), [
    ("", tuple(FORMS)),
    ("lift", tuple(FORMS)),
    ("1 jump", tuple(FORMS)),
    ("soon lift", "TIME lift"),
    ("1 lift 3", "TIME lift"),
    ("1 drift 3 4", "TIME drift ELECTRODE FACTOR SECONDS"),
    ("1 drift", "TIME drift ELECTRODE FACTOR SECONDS"),
    ("1 open 1.5", "TIME open ELECTRODE"),
    ("1 force", "TIME force NEWTON"),
    ("-1 lift", None),
    ("inf lift", None),
    ("1 force nan", None),
    ("1 open -1", None),
    ("1 drift 3 0 5", "above 0"),
    ("1 peel 3 1.5", "above 0 and at most 1"),
])  # fmt: skip
def test_bad_text_is_one_clear_sentence(text, allowed):
    with raises(BoardError, names="event", value=text, allowed=allowed):
        EmulatedFinger(16, [text])


def test_an_event_of_an_electrode_that_is_not_there_is_named():
    with raises(BoardError, names="event", value=16, allowed=15):
        EmulatedFinger(16, ["1 open 16"])


@given(text=st.text(max_size=30) | st.from_regex(r"[0-9.e-]{1,5} [a-z]{4,5}( [0-9.e-]{1,4}){0,4}"))
def test_any_text_is_an_event_or_a_sentence(text):
    with contextlib.suppress(BoardError):
        assert parse_event(text).time_s >= 0
        EmulatedFinger(16, [text])
