"""A recording as arrays: the same numbers as its steps."""

import re
from pathlib import Path

import numpy as np
import pytest

import smarttouch as st
from smarttouch.running.recording import RecordedRun


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    st.run(
        "text:on and on and on", "simulated:", mode="natural", seconds=2,
        listeners=[st.Recorder(path)],
    )  # fmt: skip
    return path


def test_its_arrays_are_those_of_its_steps(recorded):
    run, steps = st.load_recording(recorded), [*RecordedRun(recorded).steps()]
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


PAGE = Path(__file__).parents[2] / "docs/reference/recorded-data.md"


def test_the_page_describes_each_array(golden):
    arrays = vars(st.load_recording(golden("regulated")).arrays)
    rows = re.findall(r"^\| `(\w+)` \| \(([^)]*)\) (\w+) \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert {name for name, _, _ in rows} == arrays.keys()
    sizes = {
        "N": len(arrays["step"]), "N+1": len(arrays["step"]) + 1, "S": len(arrays["site"]),
        "E": 64, "V": len(arrays["volts"]), "M": len(arrays["volts_step"]), "3": 3,
    }  # fmt: skip
    assert sizes["V"] > sizes["M"] > 3
    for name, shape, kind in rows:
        sides = [side for side in shape.replace(" ", "").split(",") if side]
        assert arrays[name].shape == tuple(sizes[side] for side in sides)
        assert ("str" if arrays[name].dtype.kind == "U" else arrays[name].dtype.name) == kind
