"""A recording as arrays: the same numbers as its steps, as tables, and compared."""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.running.recording_reader import Recording


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    st.run(
        "text:on and on and on", "simulated:", mode="natural", seconds=2,
        listeners=[st.Recorder(path)],
    )  # fmt: skip
    return path


def test_its_arrays_are_those_of_its_steps(recorded):
    run, steps = st.load_recording(recorded), [*Recording(recorded).steps()]
    arrays = run.arrays
    assert arrays is run.arrays
    assert len(arrays.step) == len(steps) > 50
    last = arrays.time_ns[-1] / 1e9
    assert last < run.seconds <= last + arrays.period_us[-1] / 1e6
    assert run.profile.name == "electric-mouse"
    assert run.settings["mode"] == "natural"
    assert run.whole
    assert [words for _, words in run.events]
    for index, each in enumerate(steps):
        own, sequence = slice(*arrays.first_slot[index : index + 2]), each.step.sequence
        np.testing.assert_array_equal(arrays.current_ua[own], sequence.current_ua)
        np.testing.assert_array_equal(arrays.width_us[own], sequence.width_us)
        np.testing.assert_array_equal(arrays.activation[index], each.step.tactile.activation)
        assert arrays.force_n[index] == each.step.input.force_n
        assert arrays.time_ns[index] == each.step.input.time_ns
        assert arrays.intensity[index] == sequence.intensity
        assert arrays.mode[index] == "natural"
    for image, each in zip(run.images(), steps, strict=True):
        np.testing.assert_array_equal(image, each.step.input.image)


def test_as_a_table(recorded):
    run = st.load_recording(str(recorded))
    table = run.arrays.by_step()
    assert {len(each) for each in table.values()} == {len(run.arrays.step)}
    assert {"time_ns", "force_n", "intensity", "slots", "strongest_ua"} <= table.keys()
    assert table["slots"].sum() == len(run.arrays.site)
    assert table["strongest_ua"].max() == np.abs(run.arrays.current_ua.astype(int)).max()
    assert not table["strongest_ua"][table["slots"] == 0].any()


def test_two_are_compared(recorded, tmp_path):
    run = st.load_recording(recorded)
    assert run.compare(st.load_recording(recorded)) == {}
    for name, options in {"weaker": {"intensity": 0.5}, "shorter": {"seconds": 1}}.items():
        path = tmp_path / f"{name}.mcap"
        given = {"mode": "natural", "seconds": 2} | options
        st.run("text:on and on and on", "simulated:", listeners=[st.Recorder(path)], **given)
        found = run.compare(st.load_recording(path))
        if name == "weaker":
            assert 0 < found["current_ua"] < 5000 or np.isinf(found["current_ua"])
            assert 0 < found["intensity"] <= 0.5
        else:
            assert np.isinf(found["time_ns"])
