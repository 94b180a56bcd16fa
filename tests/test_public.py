"""The public names: few, described, with examples that run, and cheap to import."""

import doctest
import inspect
import subprocess
import sys
import threading

import numpy as np
import pytest

import smarttouch as st

from .raising import raises


def test_they_are_few_and_all_described():
    names = [name for name in dir(st) if not name.startswith("_")]
    assert len(names) <= 45
    for name in names:
        described = inspect.getdoc(getattr(st, name))
        assert described, name
        assert described.split("\n")[0].endswith("."), name
    with pytest.raises(AttributeError):
        _ = st.nothing


@pytest.mark.parametrize("name", [each for each in st.__all__ if not each.startswith("_")])
def test_every_function_has_an_example_that_runs(name):
    tests = [
        each for each in doctest.DocTestFinder().find(getattr(st, name), name) if each.examples
    ]
    for each in tests:
        assert doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(each).failed == 0
    assert tests or not inspect.isfunction(getattr(st, name))


def test_importing_it_imports_nothing_heavy():
    """Nor does its command line, before a command is chosen, or what everyone's pytest loads."""
    code = (
        "import sys, smarttouch; print(*sys.modules); "
        "import smarttouch.cli, smarttouch.testing.pytest_plugin; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    library, program = (set(line.split()) for line in done.stdout.splitlines())
    heavy = {"numpy", "cv2", "scipy", "pydantic", "serial", "mcap", "skimage", "PIL", "matplotlib"}
    assert library & (heavy | {"typer", "rich"}) == program & heavy == set()


@pytest.mark.usefixtures("patient_boards")
def test_a_run_in_ten_lines(tmp_path):
    profile = st.load_profile("electric-mouse")
    with (
        st.open_source("text:touch", profile, speed_mm_s=200) as source,
        st.open_display("emulator:", profile) as display,
    ):
        statistics = st.run(
            source, display, mode="RA", listeners=[st.Recorder(tmp_path / "run.mcap")]
        )
    assert statistics.figures["emulator_violations"] == 0
    assert statistics.frames > 0
    display = st.open_display("simulated:", profile)
    again = st.replay(tmp_path / "run.mcap", display)
    assert again.slots == statistics.slots


def test_steps_without_a_board_are_those_of_a_run():
    profile, sent = st.load_profile("electric-mouse"), []
    display = st.open_display("simulated:", profile)
    st.run(st.open_source("text:touch", profile, speed_mm_s=200), display, listeners=[sent.append])
    stepped = list(st.steps(st.open_source("text:touch", profile, speed_mm_s=200), profile))
    assert len(stepped) == len(sent) > 10
    for ours, run in zip(stepped, sent, strict=True):
        np.testing.assert_array_equal(ours.sequence.current_ua, run.sequence.current_ua)
        np.testing.assert_array_equal(ours.tactile.activation, run.tactile.activation)


@pytest.mark.usefixtures("patient_boards")
def test_a_run_in_a_thread_ends_by_its_display():
    profile, found = st.load_profile("electric-mouse"), []
    display = st.open_display("emulator:", profile)
    source, began = st.open_source("text:a long line of text", profile), threading.Event()
    thread = threading.Thread(
        target=lambda: found.append(st.run(source, display, listeners=[lambda result: began.set()]))
    )
    thread.start()
    assert began.wait(60)
    display.stop()
    thread.join(60)
    assert found[0].frames > 0
    assert found[0].figures["emulator_violations"] == 0


def test_a_kernel_is_designed_by_the_name_of_its_class():
    kernel = st.design_kernel(st.load_profile("line-8"), "RA", 3)
    assert kernel.weights.shape == (8,)
    assert abs(kernel.weights.sum()) < 1e-6 * np.abs(kernel.weights).sum()


def test_kernels_of_one_array_are_found():
    profile = st.load_profile("electric-mouse")
    assert st.load_kernels(profile).weights[st.Afferent.SAI].shape == (64, 64)


def test_errors_are_public():
    with raises(st.ProfileError, names="profile"):
        st.load_profile("nothing")
    profile = st.load_profile("electric-mouse")
    with raises(st.BoardError, names="board"):
        st.open_display("nothing:", profile)
    with raises(st.SourceError, names="source"):
        st.open_source("nothing:", profile)


def test_objects_show_themselves_in_a_line():
    profile, results = st.load_profile("electric-mouse"), []
    kernel = st.design_kernel(st.load_profile("line-8"), "RA", 3)
    display = st.open_display("simulated:", profile)
    source = st.open_source("text:a", profile)
    statistics = st.run(source, display, seconds=0.1, listeners=[results.append])
    result = results[-1]
    with display.session() as touch:
        shown = touch.show(np.eye(64, dtype=np.float32)[27], 0.1)
    for each in (
        profile, profile.electrodes, st.load_kernels(profile), kernel,
        display, display.board, source, statistics, result, result.step, result.sequence,
        result.tactile, result.input, touch, shown, st.SafetyLimits.of(profile), st.RunConfig(),
    ):  # fmt: skip
        text = repr(each)
        assert type(each).__name__ in text
        assert len(text) < 320
        assert "\n" not in text
        assert " at 0x" not in text
    plain = (str, int, float, bool, type(None), list, dict)
    assert all(type(each) in plain for each in statistics.figures.values())
